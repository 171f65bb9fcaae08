"""Re-makes the tables of the manual page: `python -m iits_mj.j1939`."""

from iits_mj.j1939.manual import PAGE, fill

PAGE.write_text(fill(PAGE.read_text(encoding="utf-8")), encoding="utf-8")
