"""Re-makes the typed messages and the manual page's tables: `python -m iits_mj.j1939`."""

import importlib

from iits_mj.j1939 import group_source, groups, manual

group_source.PATH.write_text(group_source.source(), encoding="utf-8")
importlib.reload(groups)
page = manual.fill(manual.PAGE.read_text(encoding="utf-8"))
manual.PAGE.write_text(page, encoding="utf-8")
