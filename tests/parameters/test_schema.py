"""JSON Schema of truck files: current, accepts the shipped trucks, and refuses what is wrong."""

import json
import tomllib

import pytest
from jsonschema import Draft7Validator
from truck_format import MANUAL, SECTIONS, manual_text, schema_text

from iits_mj.core.assets import mjcf_dir
from iits_mj.parameters import shipped_trucks, truck_file
from iits_mj.parameters.schema import CSV, SCHEMA_FILE, section_rows, truck_schema
from iits_mj.parameters.tables import TABLES

VALIDATOR = Draft7Validator(truck_schema())


def problems(text):
    return [
        (".".join(map(str, error.absolute_path)), error.message)
        for error in VALIDATOR.iter_errors(tomllib.loads(text))
    ]


def test_schema_and_manual_are_current():
    shipped = (mjcf_dir() / "trucks" / SCHEMA_FILE).read_text(encoding="utf-8")
    assert shipped == schema_text(), "run `python tools/truck_format.py`"
    page = MANUAL.read_text(encoding="utf-8")
    assert page == manual_text(page), "run `python tools/truck_format.py`"


def test_schema_is_itself_valid():
    Draft7Validator.check_schema(truck_schema())


@pytest.mark.parametrize("name", shipped_trucks())
def test_every_shipped_truck_is_valid_and_names_the_schema(name):
    text = truck_file(name).read_text(encoding="utf-8")
    assert text.startswith(f"#:schema ../{SCHEMA_FILE}\n")
    assert problems(text) == []


@pytest.mark.parametrize(
    ("text", "place"),
    [
        ("weight = 3", ""),
        ("[engine]\npwoer = 3", "engine"),
        ("[units.tractor.axles.axle1]\ntrak = 2.0", "units.tractor.axles.axle1"),
        ('[engine]\nidle_speed = { value = 600, unit = "rpm", grad = "L" }', "engine.idle_speed"),
        ('[engine]\nidle_speed = { value = 600, unit = "m" }', "engine.idle_speed"),
        ('[engine]\nidle_speed = { value = 600, grade = "X" }', "engine.idle_speed"),
        ("[units.tractor]\nmass = -7600", "units.tractor.mass"),
        ('[units.tractor]\nmass = "heavy"', "units.tractor.mass"),
        ('[units.trailer]\nkind = "wagon"', "units.trailer.kind"),
        ("[units.tractor.axles.axle1]\nsteered = 1", "units.tractor.axles.axle1.steered"),
        ('remove = "units.trailer"', "remove"),
    ],
)
def test_mistakes_are_refused_at_their_place(text, place):
    assert place in [found for found, _ in problems(text)]


@pytest.mark.parametrize(
    "text",
    [
        'extends = "vecto_40t"\nremove = ["units.trailer"]',
        '[units.tractor]\nmass = { value = 7.6, unit = "t", grade = "L", source = "sheet" }',
        '[units.trailer.axles.axle2]\nlike = "axle1"',
        '[units.trailer.axles."*"]\ntrack = 2.04',
        '[units.second]\nbehind = "trailer"',
        "[engine]\npower = 360e3\nauxiliaries = { fan = 1000.0 }",
        '[engine]\nfull_load = "full_load.csv"',
    ],
)
def test_every_form_of_the_format_is_accepted(text):
    assert problems(text) == []


def test_every_table_and_section_is_described():
    assert set(CSV) == {key for _, key in TABLES}
    schema = truck_schema()
    for kind in SECTIONS.values():
        assert schema["definitions"][kind]["description"]
        assert section_rows(schema, kind)


def test_rows_of_the_manual_have_units_bounds_and_meaning():
    rows = {row[0]: row[1:] for row in section_rows(truck_schema(), "Axle")}
    assert rows["spring_rate"][:2] == ("N/m, N/mm, kN/m, kN/mm", "1 to 1e+09")
    assert rows["driven"] == ("", "", "by the propeller shaft")
    kinds = {row[0]: row[2] for row in section_rows(truck_schema(), "Coupling")}
    assert kinds["kind"] == "fifth_wheel, turntable, drawbar_eye, pintle"


def test_schema_is_json():
    assert json.loads(schema_text())["additionalProperties"] is False
