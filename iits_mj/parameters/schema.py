"""JSON Schema of truck files, for editors: keys, units, bounds and meanings of the dataclasses.

The schema is of one file, which may extend another one: no key is required, unknown keys are
refused. `iits_mj.parameters.files` checks what a schema cannot, above all the bounds of values in
converted units.
"""

from __future__ import annotations

import dataclasses
import inspect
import re
import types
import typing
from typing import Any

import numpy as np

from iits_mj.parameters.files import GRADES
from iits_mj.parameters.powertrain import SHIFT_STRATEGIES
from iits_mj.parameters.quantity import CONVERSIONS, Quantity, Watts, quantity_of
from iits_mj.parameters.tables import TABLES
from iits_mj.parameters.truck import TruckParameters
from iits_mj.parameters.units import COUPLINGS, MOTOR_VEHICLES, TOWED_UNITS

Schema = dict[str, Any]

SCHEMA_FILE = "truck.schema.json"
_CHOICES: dict[tuple[str, str], tuple[str, ...]] = {
    ("Unit", "kind"): (*MOTOR_VEHICLES, *TOWED_UNITS),
    ("Coupling", "kind"): COUPLINGS,
    ("Gearbox", "shift_strategy"): SHIFT_STRATEGIES,
}
# Keys of the files that are no fields of a dataclass.
_FILE_KEYS: dict[str, dict[str, tuple[Any, str]]] = {
    "TruckParameters": {
        "extends": (str, "name of a shipped truck, or path of a file that this one changes")
    },
    "Unit": {
        "behind": (str, "the unit that tows this one; default: the one before it in the file")
    },
    "Engine": {
        "power": (Watts, "rated power: an engine of the same family as the full-load curve's")
    },
}
# What the CSV table of a key holds; a header names the columns in this order.
CSV: dict[str, str] = {
    "full_load": "rpm, full-load torque [N m]; a third column `drag...`: drag torque [N m]",
    "pedal_map": "rows: rpm; columns: accelerator pedal [%]; values: torque [N m]",
    "fuel_map": "rows: torque [N m]; columns: rpm; values: BSFC [g/kWh]",
    "fuel_rate_map": "`engine_speed` [rpm], `torque` [N m], `fuel` [g/h]",
    "drag": "`retarder_speed` [rpm], `loss_torque` [N m] of the retarder when it is off",
    "gears": "`gear`, `ratio`, and if known `inertia_in` [kg m2], `loss_map` (a CSV beside it)",
    "axle_loss": "`input_speed` [rpm], `input_torque` [N m], `torque_loss` [N m]; loss maps too",
    "upshift": "rows: gear, 1 to n - 1; columns: pedal [0..1]; values: vehicle speed [km/h]",
    "downshift": "rows: gear, 2 to n; columns: pedal [0..1]; values: vehicle speed [km/h]",
    "pressure_table": "brake pressures [kPa] over the demanded deceleration, at two masses",
}
_LIKE = "sibling table before this one, whose values this table has unless it gives its own"
_ENTRY = re.compile(r"((?:\w+, )*\w+): ")


def truck_schema() -> Schema:
    """Returns the JSON Schema (draft 7) of a `truck.toml`."""
    definitions: Schema = {}
    _define(TruckParameters, definitions)
    root = definitions.pop("TruckParameters")
    del root["properties"]["like"]
    root["properties"]["remove"] = {
        "type": "array",
        "items": {"type": "string"},
        "description": 'parameters of the extended file to leave out, "units.trailer"',
    }
    return {
        "$schema": "http://json-schema.org/draft-07/schema#",
        "title": "Truck of iits-mj",
        **root,
        "definitions": dict(sorted(definitions.items())),
    }


def section_rows(schema: Schema, name: str) -> list[tuple[str, str, str, str]]:
    """Returns (key, unit, allowed, meaning) of every key of one definition of the schema.

    `name` is the dataclass's. The first unit is the SI unit, the others are converted.
    """
    definitions, rows = schema["definitions"], []
    for key, node in definitions[name]["properties"].items():
        if key == "like":
            continue
        found = definitions.get(str(node.get("$ref", "")).rpartition("/")[2], node)
        plain, leaf = (*found.get("anyOf", ()), {}, {})[:2]
        number = plain.get("items", plain)
        low, high = number.get("minimum"), number.get("maximum")
        allowed = "" if low is None or -low == high else f"{low:.4g} to {high:.4g}"
        allowed = allowed.replace("1e-09", "above 0")
        allowed = ", ".join(plain.get("enum", ())) or allowed
        units = [] if low is None else leaf["properties"]["unit"]["enum"]
        rows.append((key, ", ".join(units), allowed, node.get("description", "")))
    return rows


def _define(kind: type[Any], definitions: Schema) -> Schema:
    """Adds a dataclass to the definitions and returns a reference to it."""
    name = kind.__name__
    reference = {"$ref": f"#/definitions/{name}"}
    if name in definitions:
        return reference
    definitions[name] = {}  # before its fields, which may refer to it
    hints = typing.get_type_hints(kind, include_extras=True)
    meaning, attributes = _described(kind)
    properties: Schema = {
        key: {**_node(hint, definitions), "description": text}
        for key, (hint, text) in (_FILE_KEYS.get(name, {}) | {"like": (str, _LIKE)}).items()
    }
    for field in dataclasses.fields(kind):
        if field.name == "name":
            continue
        node = _node(hints[field.name], definitions)
        choices = _CHOICES.get((name, field.name))
        if choices:
            node = _word(choices)
        if field.name in attributes:
            node = {**node, "description": attributes[field.name]}
        properties[field.name] = node
    for section, key in TABLES:
        if section.replace("_", "") == name.lower():
            text = f"path of a CSV table: {CSV[key]}"
            properties[key] = {"type": "string", "description": text}
    definitions[name] = {
        "type": "object",
        "description": meaning,
        "properties": properties,
        "additionalProperties": False,
    }
    return reference


def _node(hint: Any, definitions: Schema) -> Schema:
    """Returns the schema of one field's type."""
    quantity = quantity_of(hint)
    if hasattr(hint, "__metadata__"):
        hint = typing.get_args(hint)[0]
    origin = typing.get_origin(hint)
    if origin in (types.UnionType, typing.Union):
        return _node(typing.get_args(hint)[0], definitions)
    if dataclasses.is_dataclass(hint):
        return _define(typing.cast("type[Any]", hint), definitions)
    if origin is dict:
        return _tables(_node(typing.get_args(hint)[1], definitions))
    if origin is tuple:
        item = typing.get_args(hint)[0]
        if dataclasses.is_dataclass(item):
            return _tables(_define(typing.cast("type[Any]", item), definitions))
        return _quantity(quantity_of(item), "array", definitions)
    if origin is np.ndarray:
        return {"type": "array", "items": {"type": ["number", "array"]}}
    if hint in (int, float):
        kind = "integer" if hint is int else "number"
        return _quantity(quantity, kind, definitions)
    return _quantity(quantity, "boolean" if hint is bool else "string", definitions)


def _tables(item: Schema) -> Schema:
    """A table of tables by name, or by `*` for all names of the extended file."""
    return {"type": "object", "additionalProperties": item}


def _quantity(quantity: Quantity, kind: str, definitions: Schema) -> Schema:
    """Adds a plain value or `{ value, unit, grade, source }`; returns a reference to it."""
    plain: Schema = {"type": kind}
    value: Schema = {"type": kind}
    name = kind
    if kind not in ("boolean", "string"):
        bounds = {"minimum": quantity.low, "maximum": quantity.high}
        numbers = {"type": "number", **bounds}
        plain |= {"items": numbers} if kind == "array" else bounds
        value |= {"items": {"type": "number"}} if kind == "array" else {}
        name = f"{kind} {quantity.unit} {quantity.low:g} {quantity.high:g}"
    name = re.sub(r"[^\w.+-]+", "_", name.replace("/", " per "))
    definitions[name] = _either(plain, value, quantity.unit)
    return {"$ref": f"#/definitions/{name}"}


def _word(choices: tuple[str, ...]) -> Schema:
    """One of some words."""
    word = {"type": "string", "enum": list(choices)}
    return _either(word, word, "1")


def _either(plain: Schema, value: Schema, unit: str) -> Schema:
    """A plain value, or a table with the value and its provenance."""
    properties = {
        "value": value,
        "unit": {"enum": [unit, *CONVERSIONS.get(unit, {})]},
        "grade": {"enum": list(GRADES)},
        "source": {"type": "string"},
    }
    leaf = {
        "type": "object",
        "properties": properties,
        "required": ["value"],
        "additionalProperties": False,
    }
    return {"anyOf": [plain, leaf]}


def _described(kind: type[Any]) -> tuple[str, dict[str, str]]:
    """Returns a dataclass's first line, and what its docstring says of each attribute."""
    text = inspect.getdoc(kind) or ""
    head, _, rest = text.partition("Attributes:\n")
    names = {field.name for field in dataclasses.fields(kind)} | {key for _, key in TABLES}
    found: dict[str, str] = {}
    # Entries begin a line or follow a semicolon.
    for part in re.split(r"\n(?=  \w)|; ", rest):
        line = " ".join(part.split())
        entry = _ENTRY.match(line)
        keys = entry[1].split(", ") if entry else []
        if entry and names.issuperset(keys):
            found |= dict.fromkeys(keys, line[entry.end() :].rstrip("."))
            last = keys
        elif found:
            found |= {key: f"{found[key]}; {line.rstrip('.')}" for key in last}
    return head.strip().split("\n")[0], found
