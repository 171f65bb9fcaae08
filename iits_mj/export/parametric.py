"""Parameters of a scenario in its OpenSCENARIO file, with expressions in place of numbers.

The numbers of the file are computed from those of the events. Where they are affine functions of a
parameter, which files at both ends of its range show, they become expressions of it; otherwise the
file has the parameter's value.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from xml.etree.ElementTree import Element, SubElement

from iits_mj.core.errors import InputError
from iits_mj.export.story import DIGITS
from traffic_bridge.scenario.parameters import Parameter

SAME = 2.0 * 10.0**-DIGITS  # numbers of a file that differ by less are equal
RULES = ("greaterOrEqual", "lessOrEqual")  # of the ends of a range

Build = Callable[[Mapping[str, float]], Element]
Place = tuple[Element, str]  # an attribute
Slopes = dict[str, dict[int, float]]  # by parameter and number of the attribute


def with_parameters(
    root: Element, parameters: Mapping[str, Parameter], values: Mapping[str, object], build: Build
) -> list[str]:
    """Declares parameters in a file, and writes the numbers that depend on them as expressions.

    Args:
      root: of the file, which is changed.
      parameters: of the scenario by name.
      values: in force, by name.
      build: returns the file with other values of some parameters.

    Returns:
      Why parameters are written with their values, in words.
    """
    places, remarks, slopes = _places(root), list[str](), Slopes()
    ranges: dict[str, tuple[float, float]] = {}
    for name, parameter in parameters.items():
        limits = {rule: float(v) for group in parameter.limits for rule, v in group}
        number, why = values[name], ""
        if isinstance(number, (bool, str)) or len(limits) < len(RULES):
            why = "it has no low and high"
        elif isinstance(number, int):
            why = "it is a whole number"
        else:
            ranges[name] = limits[RULES[0]], limits[RULES[1]]
            here = {each: float(values[each]) for each in ranges}  # type: ignore[arg-type]
            try:
                slopes[name] = _slopes(places, name, ranges[name], build)
                _check(places, slopes, here, ranges, build)
            except InputError as error:
                why = str(error)
        if why:
            slopes.pop(name, None)
            ranges.pop(name, None)
            remarks.append(f"parameter {name} is written with its value {number}: {why}")
    _write(root, places, slopes, ranges, values)
    return remarks


def _places(root: Element) -> list[Place]:
    """The attributes of a file in their order, without those of its header."""
    parts = (part for part in root if part.tag != "FileHeader")
    return [(each, name) for part in parts for each in part.iter() for name in each.attrib]


def _numbers(places: list[Place], root: Element) -> Iterator[tuple[int, float, float]]:
    """The numbers that differ in another form of a file: place, there and here.

    Raises:
      InputError: other things differ, too.
    """
    others = _places(root)
    texts = [[each.text for each, _ in these] for these in (places, others)]
    names = [[(each.tag, name) for each, name in these] for these in (places, others)]
    if names[0] != names[1] or texts[0] != texts[1]:
        raise InputError("other elements are written for other values of it")
    for k, ((here, name), (there, _)) in enumerate(zip(places, others, strict=True)):
        if here.get(name) != there.get(name):
            try:
                yield k, float(there.get(name, "")), float(here.get(name, ""))
            except ValueError:
                raise InputError(
                    f"{name} of {here.tag} depends on it, which is no number"
                ) from None


def _slopes(
    places: list[Place], name: str, ends: tuple[float, float], build: Build
) -> dict[int, float]:
    """Changes of the numbers over the range of a parameter, per unit of it."""
    low, high = ({k: there for k, there, _ in _numbers(places, build({name: x}))} for x in ends)
    here = {k: float(places[k][0].get(places[k][1], "")) for k in low.keys() | high.keys()}
    way, found = ends[1] - ends[0], dict[int, float]()
    for k, number in here.items():
        slope = (high.get(k, number) - low.get(k, number)) / way
        # Without the rounding of the file's numbers.
        short = round(slope, DIGITS)
        found[k] = short if abs(slope - short) * way <= SAME else slope
    return found


def _check(
    places: list[Place],
    slopes: Slopes,
    here: Mapping[str, float],
    ranges: Mapping[str, tuple[float, float]],
    build: Build,
) -> None:
    """Checks that the numbers are those of the slopes at both ends, and with the other parameters.

    Raises:
      InputError: they are not.
    """
    last = list(ranges)[-1]
    corners = [{last: end} for end in ranges[last]]
    # No parameter has its own value there, so that products of two show.
    far = {name: max(ends, key=lambda x: abs(x - here[name])) for name, ends in ranges.items()}
    corners += [
        {name: here[name] + share * (x - here[name]) for name, x in far.items()}
        for share in (1.0, 0.5)
    ]
    for corner in corners:
        found = {k: there - now for k, there, now in _numbers(places, build(corner))}
        for k in {*found, *(k for name in corner for k in slopes[name])}:
            change = sum(slopes[n].get(k, 0.0) * (x - here[n]) for n, x in corner.items())
            if abs(found.get(k, 0.0) - change) > SAME * (1.0 + abs(change)):
                element, name = places[k]
                raise InputError(f"{name} of {element.tag} is not linear in it")


def _write(
    root: Element,
    places: list[Place],
    slopes: Slopes,
    ranges: Mapping[str, tuple[float, float]],
    values: Mapping[str, object],
) -> None:
    """Declares the parameters of the slopes, and writes the expressions."""
    if not ranges:
        return
    declared = Element("ParameterDeclarations")
    root.insert(1, declared)  # behind the header
    for name, ends in ranges.items():
        about = {"name": name, "parameterType": "double", "value": repr(values[name])}
        group = SubElement(SubElement(declared, "ParameterDeclaration", about), "ConstraintGroup")
        for rule, end in zip(RULES, ends, strict=True):
            SubElement(group, "ValueConstraint", {"rule": rule, "value": repr(end)})
    for k in sorted({k for each in slopes.values() for k in each}):
        element, attribute = places[k]
        rest, terms = float(element.attrib[attribute]), list[str]()
        for name, found in slopes.items():
            if (slope := found.get(k, 0.0)) != 0.0:
                rest -= slope * float(values[name])  # type: ignore[arg-type]
                terms.append(f"${name}" if slope == 1.0 else f"{slope!r} * ${name}")
        if not terms:
            continue
        if (rest := round(rest, DIGITS)) != 0.0:
            terms.append(repr(rest))
        alone = len(terms) == 1 and terms[0].startswith("$")
        text = " + ".join(terms).replace("+ -", "- ")
        element.set(attribute, text if alone else f"${{{text}}}")
