"""Writes the JSON Schema of truck files, and the tables of keys in `docs/trucks.md`.

    python tools/truck_format.py

A test compares both files with the dataclasses.
"""

from __future__ import annotations

import json
from pathlib import Path

from iits_mj.core.assets import mjcf_dir
from iits_mj.core.errors import InputError
from iits_mj.parameters.schema import CSV, SCHEMA_FILE, section_rows, truck_schema
from iits_mj.parameters.tables import TABLES

MANUAL = Path(__file__).resolve().parents[1] / "docs" / "trucks.md"
START = "<!-- keys: made by `python tools/truck_format.py` -->"
END = "<!-- end of keys -->"
# Sections of the file and the dataclass of each.
SECTIONS = {
    "units.NAME": "Unit",
    "units.NAME.axles.AXLE": "Axle",
    "units.NAME.axles.AXLE.brake": "AxleBrake",
    "units.NAME.axles.AXLE.self_steering": "SelfSteering",
    "units.NAME.coupling": "Coupling",
    "units.NAME.payload": "Payload",
    "tires.KIND": "Tire",
    "tire_common": "TireCommon",
    "steering": "Steering",
    "aerodynamics": "Aerodynamics",
    "engine": "Engine",
    "gearbox": "Gearbox",
    "gearbox.shifting": "Shifting",
    "clutch": "Clutch",
    "retarder": "Retarder",
    "air_brake": "AirBrake",
}


def schema_text() -> str:
    """Returns the content of the schema's file."""
    return json.dumps(truck_schema(), indent=1) + "\n"


def manual_text(text: str) -> str:
    """Returns the manual page with new tables.

    Raises:
      InputError: the page lacks the tables' markers.
    """
    head, start, rest = text.partition(START)
    _, end, tail = rest.partition(END)
    if not (start and end):
        raise InputError(f"{MANUAL.name} lacks the markers {START!r} and {END!r}")
    schema = truck_schema()
    lines = ["", "| CSV table | columns |", "|---|---|"]
    lines += [f"| `{section}.{key}` | {CSV[key]} |" for section, key in TABLES]
    for section, kind in SECTIONS.items():
        lines += ["", f"### `[{section}]`", "", schema["definitions"][kind]["description"], ""]
        lines += ["| key | units | allowed | meaning |", "|---|---|---|---|"]
        for key, units, allowed, meaning in section_rows(schema, kind):
            lines.append(f"| `{key}` | {units} | {allowed} | {meaning} |")
    return "\n".join([head + start, *lines, "", end]) + tail


if __name__ == "__main__":
    (mjcf_dir() / "trucks" / SCHEMA_FILE).write_text(schema_text(), encoding="utf-8")
    MANUAL.write_text(manual_text(MANUAL.read_text(encoding="utf-8")), encoding="utf-8")
