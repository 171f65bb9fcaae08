"""Exported model folders: complete, loadable, and clear about the plugin."""

import subprocess
import sys

import mujoco
import pytest

from iits_mj.core.errors import InputError
from iits_mj.parameters import TruckParameters
from iits_mj.truck.export import export_truck

LOADS = "import mujoco; mujoco.MjModel.from_xml_path('truck.xml')"


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    found = tmp_path_factory.mktemp("export") / "model"
    export_truck("rigid_drawbar", found, b"\x89PNG")
    return found


def test_folder_has_the_files_of_a_menagerie_model(folder):
    names = {path.name for path in folder.iterdir()}
    assert names == {
        "truck.xml", "scene.xml", "assets", "LICENSE", "README.md", "truck.png", "load.py"
    }  # fmt: skip
    assert "Apache License" in (folder / "LICENSE").read_text()


@pytest.mark.parametrize("scene", ["truck.xml", "scene.xml"])
def test_exported_model_is_the_laden_truck(folder, scene):
    model = mujoco.MjModel.from_xml_path(str(folder / scene))
    truck = TruckParameters.load("rigid_drawbar")
    assert model.body_subtreemass[model.body("tractor").id] == pytest.approx(
        truck.gross_mass(truck.payload_max)
    )
    data = mujoco.MjData(model)
    mujoco.mj_step(model, data, 500)
    assert not data.warning.number.any()


def test_readme_shows_picture_plugin_and_provenance(folder):
    text = (folder / "README.md").read_text(encoding="utf-8")
    assert "![the truck](truck.png)" in text
    assert "mj_loadPluginLibrary" in text
    assert "| units.tractor.mass | 10200.0 | kg | J | chassis with body |" in text
    assert "`accelerator_pedal`, `xbr_demand`" in text


def test_without_plugin_mujoco_names_the_line_below_the_hint(folder):
    done = subprocess.run(
        [sys.executable, "-c", LOADS], cwd=folder, capture_output=True, text=True, check=False
    )
    assert done.returncode != 0
    assert "plugin iits.tire not found" in done.stderr
    line = int(done.stderr.rpartition("line ")[2].split()[0])
    above = (folder / "truck.xml").read_text().splitlines()[line - 3]
    assert 'If MuJoCo says "plugin iits.tire not found"' in above


def test_loader_of_the_folder_registers_the_plugin(folder):
    code = "from load import load; print(load().nu)"
    done = subprocess.run(
        [sys.executable, "-c", code], cwd=folder, capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stderr
    assert int(done.stdout) == 10


def test_second_export_leaves_no_meshes_of_the_first(tmp_path):
    (tmp_path / "assets").mkdir()
    (tmp_path / "assets" / "old.obj").write_text("v 0 0 0\n")
    export_truck("vecto_tractor", tmp_path, None)
    assert not (tmp_path / "assets" / "old.obj").exists()
    assert "truck.png" not in (tmp_path / "README.md").read_text(encoding="utf-8")


def test_unwritable_folder_is_refused(tmp_path):
    (tmp_path / "file").write_text("")
    with pytest.raises(InputError, match="cannot be written"):
        export_truck("vecto_tractor", tmp_path / "file" / "model", None)
