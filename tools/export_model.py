"""Writes the default truck's model: MJCF, meshes, and the README's table of provenance.

    python tools/export_model.py

A test compares the files with the builder.
"""

from __future__ import annotations

from pathlib import Path

from iits_mj.core.assets import mjcf_dir
from iits_mj.core.errors import InputError
from iits_mj.parameters import TruckParameters
from iits_mj.truck import export

XML_HEADER = (
    "<!-- The 12-wheel tractor-semitrailer, laden to 55 t. Made from truck.toml by "
    "`python tools/export_model.py`: change the figures there, not here. -->\n"
)
TABLE_START = "<!-- provenance: made by `python tools/export_model.py` -->"
TABLE_END = "<!-- end of provenance -->"


def model_files() -> dict[str, str]:
    """Texts of the laden truck's `truck.xml` and its meshes, by path below the model folder."""
    return export.model_files(TruckParameters.load(), XML_HEADER)


def write_model(folder: Path) -> None:
    """Writes the model's files and the provenance table of the README into `folder`."""
    (folder / export.MESH_FOLDER).mkdir(exist_ok=True)
    for name, text in model_files().items():
        (folder / name).write_text(text, encoding="utf-8")
    readme = folder / "README.md"
    readme.write_text(readme_text(readme.read_text(encoding="utf-8")), encoding="utf-8")


def readme_text(text: str) -> str:
    """The README with a new provenance table.

    Raises:
      InputError: the README lacks the table's markers.
    """
    head, start, rest = text.partition(TABLE_START)
    _, end, tail = rest.partition(TABLE_END)
    if not (start and end):
        raise InputError(f"mjcf/README.md lacks the markers {TABLE_START!r} and {TABLE_END!r}")
    return "\n".join([head + start, "", *export.provenance_rows(), "", end]) + tail


if __name__ == "__main__":
    write_model(mjcf_dir())
