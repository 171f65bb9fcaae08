"""Re-makes what is derived from `mjcf/truck.toml`: `python -m iits_mj.model`.

Writes `mjcf/truck.xml` (the laden truck) and the provenance table of `mjcf/README.md`.
"""

from __future__ import annotations

from iits_mj.assets import mjcf_dir
from iits_mj.model.export import readme_text, truck_xml_text


def main() -> None:
    """Writes the files."""
    folder = mjcf_dir()
    (folder / "truck.xml").write_text(truck_xml_text(), encoding="utf-8")
    readme = folder / "README.md"
    readme.write_text(readme_text(readme.read_text(encoding="utf-8")), encoding="utf-8")


main()
