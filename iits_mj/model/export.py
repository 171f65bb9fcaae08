"""The model as files: the static MJCF and the provenance table of its README."""

from __future__ import annotations

from iits_mj.errors import InputError
from iits_mj.model.builder import truck_spec
from iits_mj.parameters import TruckParameters, provenance
from iits_mj.plugin_library import register

XML_HEADER = (
    "<!-- The 12-wheel tractor-semitrailer, laden to 55 t. Made from truck.toml by "
    "`python -m iits_mj.model`: change the figures there, not here. -->\n"
)
TABLE_START = "<!-- provenance: made by `python -m iits_mj.model` -->"
TABLE_END = "<!-- end of provenance -->"


def truck_xml_text(payload: float | None = None) -> str:
    """Static MJCF of the truck with this payload [kg], by default the greatest."""
    register()
    parameters = TruckParameters.load()
    payload = parameters.payload.mass_max if payload is None else payload
    spec = truck_spec(parameters, payload)
    spec.compile()
    return XML_HEADER + str(spec.to_xml())


def readme_text(text: str) -> str:
    """The README with its provenance table renewed.

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
