"""Writes the default truck's model: MJCF, meshes, and the README's table of provenance.

    python tools/export_model.py

A test compares the files with the builder.
"""

from __future__ import annotations

from pathlib import Path

import mujoco
import numpy as np

from iits_mj.core.assets import mjcf_dir
from iits_mj.core.errors import InputError
from iits_mj.model.builder import truck_spec
from iits_mj.parameters import TruckParameters
from iits_mj.parameters.files import provenance
from iits_mj.plugin import register

XML_HEADER = (
    "<!-- The 12-wheel tractor-semitrailer, laden to 55 t. Made from truck.toml by "
    "`python tools/export_model.py`: change the figures there, not here. -->\n"
)
MESH_FOLDER = "assets"
TABLE_START = "<!-- provenance: made by `python tools/export_model.py` -->"
TABLE_END = "<!-- end of provenance -->"


def model_files() -> dict[str, str]:
    """Texts of the laden truck's `truck.xml` and its meshes, by path below the model folder."""
    register()
    parameters = TruckParameters.load()
    spec = truck_spec(parameters, parameters.payload_max)
    files = {}
    for mesh in spec.meshes:
        name = f"{mesh.name}.obj"
        files[f"{MESH_FOLDER}/{name}"] = _wavefront(mesh)
        mesh.file = name
        mesh.uservert, mesh.userface = [], []
    spec.meshdir = MESH_FOLDER
    assets = {name.removeprefix(f"{MESH_FOLDER}/"): text.encode() for name, text in files.items()}
    spec.assets = assets
    spec.compile()
    return {"truck.xml": XML_HEADER + str(spec.to_xml()), **files}


def write_model(folder: Path) -> None:
    """Writes the model's files and the provenance table of the README into `folder`."""
    (folder / MESH_FOLDER).mkdir(exist_ok=True)
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
    rows = ["| figure | value | unit | grade | source |", "|---|---|---|---|---|"]
    rows += [f"| {' | '.join(row)} |" for row in provenance()]
    return "\n".join([head + start, "", *rows, "", end]) + tail


def _wavefront(mesh: mujoco.MjsMesh) -> str:
    """A mesh of vertices and triangles as Wavefront OBJ, to a tenth of a millimeter.

    Zeros have no sign: it comes from rounding, which differs between processors.
    """
    vertices = np.array(mesh.uservert).reshape(-1, 3)
    faces = np.array(mesh.userface).reshape(-1, 3) + 1
    lines = [f"v {x:z.4f} {y:z.4f} {z:z.4f}" for x, y, z in vertices]
    lines += [f"f {a} {b} {c}" for a, b, c in faces]
    return "\n".join(lines) + "\n"


if __name__ == "__main__":
    write_model(mjcf_dir())
