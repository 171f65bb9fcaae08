"""Writes a truck as a model folder in the shape of MuJoCo Menagerie's: MJCF, meshes, README."""

from __future__ import annotations

import importlib.metadata
from pathlib import Path

import mujoco
import numpy as np

from iits_mj.core.assets import mjcf_path
from iits_mj.core.errors import InputError
from iits_mj.core.messages import VehicleCommand
from iits_mj.core.output_files import write_whole
from iits_mj.model.builder import truck_spec
from iits_mj.parameters import TruckParameters
from iits_mj.parameters.files import provenance
from iits_mj.plugin import register
from iits_mj.truck.check import inspect_truck

MESH_FOLDER = "assets"
PICTURE = "truck.png"
_NOT_FOUND = "plugin iits.tire not found"  # MuJoCo's message without the plugin
_HINT = (
    f'  <!-- If MuJoCo says "{_NOT_FOUND}": this model needs the engine plugin of the Python '
    "package iits-mj. Use load.py beside this file, or `import iits_mj` before you load the model; "
    "in C or C++ call mj_loadPluginLibrary with the path that `python -c 'from iits_mj.plugin "
    "import library_path; print(library_path())'` prints. -->\n"
)
_EXTENSION = "  <extension>\n"
_LOADER = '''"""Loads this truck into plain MuJoCo; `python load.py` shows it in the viewer."""

from pathlib import Path

import mujoco
import mujoco.viewer


def load(scene: str = "scene.xml") -> mujoco.MjModel:
    """Registers the engine plugin and returns the model."""
    try:
        from iits_mj.plugin import register
    except ImportError:
        raise SystemExit("this model needs the package iits-mj: pip install iits-mj") from None
    register()
    return mujoco.MjModel.from_xml_path(str(Path(__file__).with_name(scene)))


if __name__ == "__main__":
    mujoco.viewer.launch(load())
'''


def model_files(parameters: TruckParameters, header: str, hint: str = "") -> dict[str, str]:
    """Returns the texts of the laden truck's `truck.xml` and its meshes, by path in the folder.

    Args:
      parameters: of the truck.
      header: comment at the top of `truck.xml`.
      hint: comment above its `<extension>`, whose lines MuJoCo names when the plugin is missing.
    """
    register()
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
    text = str(spec.to_xml()).replace(_EXTENSION, hint + _EXTENSION, 1)
    return {"truck.xml": header + text, **files}


def provenance_rows(truck: str | Path | None = None) -> list[str]:
    """Returns the lines of a Markdown table with every quantity, its unit, grade and source."""
    rows = ["| figure | value | unit | grade | source |", "|---|---|---|---|---|"]
    return [*rows, *(f"| {' | '.join(row)} |" for row in provenance(truck))]


def export_truck(truck: str | Path, folder: Path, picture: bytes | None) -> None:
    """Writes the model folder of a truck.

    Args:
      truck: name of a shipped truck, a `truck.toml`, or a folder with one.
      folder: is made; files with the same names are replaced, meshes of an older export removed.
      picture: PNG for the README, or None.

    Raises:
      InputError: the truck's file is wrong, or the folder cannot be written.
    """
    found = inspect_truck(truck)
    parameters = TruckParameters.load(truck)
    mass = parameters.gross_mass(parameters.payload_max) / 1e3
    header = (
        f"<!-- {found.name.replace('--', '-')}, laden to {mass:.1f} t. Made by "
        "`iits-mj truck export`: change the truck's TOML file, not this one. -->\n"
    )
    files = model_files(parameters, header, _HINT)
    files["scene.xml"] = mjcf_path("scene.xml").read_text(encoding="utf-8")
    files["load.py"] = _LOADER
    files["LICENSE"] = _license()
    files["README.md"] = _readme(truck, found.summary, found.name, picture is not None)
    content = {name: text.encode() for name, text in files.items()}
    if picture is not None:
        content[PICTURE] = picture
    try:
        (folder / MESH_FOLDER).mkdir(parents=True, exist_ok=True)
        for old in (folder / MESH_FOLDER).glob("*.obj"):
            if f"{MESH_FOLDER}/{old.name}" not in files:
                old.unlink()
    except OSError as error:
        raise InputError(f"folder {str(folder)!r} cannot be written: {error.strerror}") from error
    for name, data in content.items():
        write_whole(folder / name, data, "model file")


def _readme(truck: str | Path, summary: list[tuple[str, str]], name: str, pictured: bool) -> str:
    controls = ", ".join(f"`{field}`" for field in VehicleCommand.__dataclass_fields__)
    return "\n".join(
        [
            f"# {name}",
            "",
            *([f"![the truck]({PICTURE})", ""] if pictured else []),
            "Made by `iits-mj truck export` from the truck's TOML file.",
            "",
            "| | |",
            "|---|---|",
            *(f"| {key} | {value.replace('|', '/')} |" for key, value in summary),
            "",
            "## Load it",
            "",
            "A MuJoCo engine plugin computes tires, couplings, steering, powertrain and air "
            f'brakes. Without it MuJoCo says "{_NOT_FOUND}". The package `iits-mj` has it:',
            "",
            "```python",
            "import iits_mj  # registers the plugin",
            "import mujoco",
            "",
            'model = mujoco.MjModel.from_xml_path("scene.xml")',
            "data = mujoco.MjData(model)",
            "data.ctrl[0] = 0.4  # accelerator pedal",
            "while data.time < 10:",
            "    mujoco.mj_step(model, data)",
            'print(data.sensor("tractor_velocity").data[0])',
            "```",
            "",
            "`python load.py` shows the truck in MuJoCo's viewer. In C or C++, and in the viewer's "
            "own program, load the library whose path this prints with `mj_loadPluginLibrary`; it "
            f"is built for MuJoCo {mujoco.__version__}:",
            "",
            "```",
            'python -c "from iits_mj.plugin import library_path; print(library_path())"',
            "```",
            "",
            f"Controls, in this order: {controls}.",
            "",
            "## Provenance",
            "",
            "Grades: **P** printed in the paper, **R** read from its authors' public release, "
            "**D** derived, **L** literature or standard, **J** our judgement.",
            "",
            *provenance_rows(truck),
            "",
        ]
    )


def _license() -> str:
    text = importlib.metadata.distribution("iits-mj").read_text("licenses/LICENSE")
    if text is None:
        raise InputError("the license of iits-mj is missing; reinstall it")
    return text


def _wavefront(mesh: mujoco.MjsMesh) -> str:
    """A mesh of vertices and triangles as Wavefront OBJ, to a tenth of a millimeter.

    Zeros have no sign: it comes from rounding, which differs between processors.
    """
    vertices = np.array(mesh.uservert).reshape(-1, 3)
    faces = np.array(mesh.userface).reshape(-1, 3) + 1
    lines = [f"v {x:z.4f} {y:z.4f} {z:z.4f}" for x, y, z in vertices]
    lines += [f"f {a} {b} {c}" for a, b, c in faces]
    return "\n".join(lines) + "\n"
