"""Every example of the plugin's manuals runs as printed, and every attribute is explained."""

import re
from pathlib import Path

import mujoco
import numpy as np
import pytest

import iits_mj

PLUGIN = Path(iits_mj.plugin.__file__).parent
if not PLUGIN.is_dir():
    pytest.skip("the plugin's sources are not installed", allow_module_level=True)
MANUALS = sorted(PLUGIN.glob("README*.md"))
EXAMPLES = [
    (path.name, xml)
    for path in MANUALS
    for xml in re.findall(r"```xml\n(<mujoco>.*?)```", path.read_text(), re.DOTALL)
]


@pytest.mark.parametrize(("manual", "xml"), EXAMPLES, ids=[name for name, _ in EXAMPLES])
def test_example_runs_without_a_warning(manual, xml):
    model = mujoco.MjModel.from_xml_string(xml)
    data = mujoco.MjData(model)
    mujoco.mj_step(model, data, 500)
    assert np.isfinite(data.qpos).all()
    assert data.warning.number.sum() == 0


def test_powertrain_example_drives_off():
    model = mujoco.MjModel.from_xml_string(dict(EXAMPLES)["README_powertrain.md"])
    data = mujoco.MjData(model)
    data.ctrl[0] = 0.6
    mujoco.mj_step(model, data, 5000)
    assert data.qvel[0] > 3.0
    assert data.sensor("gear").data[0] > 1


def test_air_brake_example_stops():
    model = mujoco.MjModel.from_xml_string(dict(EXAMPLES)["README_air_brake.md"])
    data = mujoco.MjData(model)
    data.qvel[:] = 15.0, 15.0 / 0.51, 15.0 / 0.51
    data.ctrl[:] = -3.0, 2.0
    mujoco.mj_step(model, data, 5000)
    assert abs(data.qvel[0]) < 1e-3


# A row of an attribute table in C++: `Number("ratio", ...)`, `{"efficiency", [...`.
ROW = re.compile(r'(?:Number|Text|Axis|Values|Ordered|per_axle|common)\("(\w+)"|\{"(\w+)",\s*\[')
ATTRIBUTES = {"tire": 23, "steering": 16, "fifth_wheel": 7, "aerodynamics": 6}
ATTRIBUTES |= {"powertrain": 141, "air_brake": 71}


@pytest.mark.parametrize("plugin", ATTRIBUTES)
def test_manual_explains_every_attribute_in_its_table(plugin):
    source = (PLUGIN / f"{plugin}.cc").read_text()
    table = re.search(
        r"Attributes (?:\w+::)?Table\(\) \{(.*?)\n *\};\n *\}\n", source, re.DOTALL
    ).group(1)
    names = {name for pair in ROW.findall(table) for name in pair if name}
    manual = "\n".join(path.read_text() for path in MANUALS)
    section = re.search(rf"^#+ `iits\.{plugin}`\n(.*?)(?=^#+ `iits\.|\Z)", manual, re.DOTALL | re.M)
    rows = [row for row in section.group(1).splitlines() if row.startswith("| `")]
    assert {name for row in rows for name in re.findall(r"`(\w+)`", row)} >= names
    assert len(names) == ATTRIBUTES[plugin]
