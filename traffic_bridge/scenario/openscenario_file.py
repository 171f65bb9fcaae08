"""Elements of OpenSCENARIO files: lines in messages, parameters, expressions and catalogs."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any, NoReturn
from xml.etree.ElementTree import Element

from iits_mj.core.checks import did_you_mean
from iits_mj.core.errors import InputError, MapError
from iits_mj.core.input_files import similar_file
from iits_mj.road.xml_input import parse_xml
from traffic_bridge.scenario.parameters import declared, evaluate

SIZE_MAX = 256 * 2**20  # bytes of a file; a minute among 60 vehicles takes 7 MB
BOOLEANS = {"true": True, "1": True, "false": False, "0": False}
CATALOG_FILES_MAX = 100


class Node:
    """An element with its file, its line, and the parameters in force.

    Iterating gives the children.
    """

    def __init__(
        self, path: Path, element: Element, lines: Mapping[Element, int], scope: Mapping[str, str]
    ) -> None:
        self.path, self.element, self.lines, self.scope = path, element, lines, scope
        self.tag = element.tag

    def __iter__(self) -> Iterator[Node]:
        return (Node(self.path, e, self.lines, self.scope) for e in self.element)

    def fail(self, message: str) -> NoReturn:
        """Raises InputError with the file, the line and the element."""
        line = self.lines.get(self.element, 0)
        raise InputError(f"{self.path}: line {line}: <{self.tag}>: {message}")

    def refuse(self) -> NoReturn:
        """Raises InputError: the element is outside of what is read."""
        self.fail("this element is not supported")

    def only(self, *tags: str) -> Node:
        """Returns the node itself, after it refused children with other tags."""
        for child in self:
            if child.tag not in tags:
                child.refuse()
        return self

    def find(self, tag: str) -> Node | None:
        """Returns the first child with a tag; None if there is none."""
        return next((child for child in self if child.tag == tag), None)

    def first(self, *tags: str) -> Node:
        """Returns the first child; InputError if there is none, or one with another tag."""
        found = next(iter(self), None) or self.fail("has no element")
        return found if not tags or found.tag in tags else found.refuse()

    def child(self, tag: str, *below: str) -> Node:
        """Returns the first child with a tag, or below it; InputError if there is none."""
        found = self.find(tag)
        if found is None:
            has = ", ".join(f"<{child.tag}>" for child in self) or "nothing"
            self.fail(f"needs <{tag}>; it has {has}")
        return found.child(*below) if below else found

    def scoped(
        self, assigned: Mapping[str, str] | None = None, reference: Node | None = None
    ) -> Node:
        """Returns the node with its declared parameters, some with values of a reference."""
        scope, assigned = dict(self.scope), assigned or {}
        names = [each.declared for each in self.find("ParameterDeclarations") or ()]
        for name in assigned:
            if name not in names:
                has = f"; it has {', '.join(names)}" if names else ""
                (reference or self).fail(
                    f"there is no parameter {name!r}{did_you_mean(name, names)}{has}"
                )
        for each in self.find("ParameterDeclarations") or ():
            name, inner = each.declared, Node(self.path, each.element, self.lines, scope)
            scope[name] = assigned[name] if name in assigned else inner.get("value")
        return Node(self.path, self.element, self.lines, scope)

    def get(self, name: str, default: str | None = None) -> str:
        """Returns an attribute with its parameters and expressions replaced by values."""
        text = self.element.get(name, default)
        if text is None:
            self.fail(f"has no attribute {name!r}")
        text = text.strip()
        try:
            if text.startswith("${") and text.endswith("}"):
                return repr(evaluate(text[2:-1], self.scope))
            if text.startswith("$"):
                return str(declared(text[1:], self.scope))
        except InputError as error:
            self.fail(str(error))
        return text

    def flag(self, name: str) -> bool:
        """Returns a truth value, false where the attribute is missing."""
        text = self.get(name, "false").lower()
        if text not in BOOLEANS:
            self.fail(f"{name} = {text[:40]!r} is neither true nor false")
        return BOOLEANS[text]

    @property
    def declared(self) -> str:
        """Name of a declaration, without the sign of a parameter before it."""
        return self.element.get("name", "").lstrip("$")

    def has(self, name: str) -> bool:
        """Whether it has an attribute."""
        return name in self.element.attrib

    def value(self, name: str) -> float | str:
        """Returns an attribute as a number if it is a finite one, else as text."""
        return number_or_text(self.get(name))

    def all(self, tag: str) -> Iterator[Node]:
        """Yields all elements below with a tag."""
        for element in self.element.iter(tag):
            yield Node(self.path, element, self.lines, self.scope)

    def number(
        self, name: str, default: float | None = None, low: float = -1e8, high: float = 1e8
    ) -> float:
        """Returns an attribute as a finite number within bounds."""
        text = self.get(name, None if default is None else repr(default))
        try:
            value = float(text)
        except ValueError:
            self.fail(f"{name} = {text[:40]!r} is not a number")
        if not low <= value <= high:
            self.fail(f"{name} = {text[:40]}: allowed is {low:g} to {high:g}")
        return value


def number_or_text(text: str) -> float | str:
    """Returns a text as a number if it is a finite one."""
    try:
        value = float(text)
    except ValueError:
        return text
    return value if math.isfinite(value) else text


def read_root(path: Path) -> Node:
    """Reads a scenario or a catalog.

    Raises:
      InputError: the file cannot be read or is no OpenSCENARIO XML.
    """
    try:
        size = path.stat().st_size
        if size > SIZE_MAX:
            raise InputError(f"{path}: {size} bytes are more than {SIZE_MAX} allowed")
        content = path.read_bytes()
    except (OSError, ValueError) as error:
        reason = getattr(error, "strerror", None) or error
        raise InputError(f"{path}: cannot be read: {reason}{similar_file(path)}") from error
    lines: dict[Element, int] = {}
    try:
        root = parse_xml(content, str(path), lines)
    except MapError as error:
        raise InputError(str(error)) from error
    if root.tag != "OpenSCENARIO":
        raise InputError(f"{path}: the root element is <{root.tag[:40]}>, not <OpenSCENARIO>")
    return Node(path, root, lines, {})


class Catalogs:
    """The catalogs of a scenario; files are read when an entry of them is needed."""

    def __init__(self, root: Node) -> None:
        self._scope = root.scope
        self._folders: list[Path] = []
        for location in root.find("CatalogLocations") or ():
            if (folder := location.find("Directory")) is not None:
                self._folders.append(root.path.parent / folder.get("path"))
        self._read: dict[Path, Any] = {}

    def resolve(self, node: Node) -> Node:
        """Returns the entry to which a CatalogReference refers; another node itself."""
        if node.tag != "CatalogReference":
            return node.scoped()
        catalog, entry = node.get("catalogName"), node.get("entryName")
        assigned = {
            each.element.get("parameterRef", "").lstrip("$"): each.get("value")
            for each in node.find("ParameterAssignments") or ()
        }
        there: list[str] = []
        for found in self._catalogs(node, catalog):
            for child in found:
                if (name := child.element.get("name", "")) == entry:
                    return child.scoped(assigned, node)
                there.append(name)
        if there:
            node.fail(f"catalog {catalog!r} has no entry {entry!r}{did_you_mean(entry, there)}")
        for folder in self._folders:
            if not folder.is_dir():
                node.fail(f"the folder {folder} of the CatalogLocations does not exist")
        return node.fail(f"the CatalogLocations have no catalog {catalog!r}")

    def files(self) -> list[Path]:
        """Returns the catalogs of the locations, in their order."""
        return [path for folder in dict.fromkeys(self._folders) for path in _files(folder)]

    def _catalogs(self, node: Node, name: str) -> Iterator[Node]:
        for folder in dict.fromkeys(self._folders):
            paths = _files(folder)
            if len(paths) > CATALOG_FILES_MAX:
                node.fail(f"{folder} has more than {CATALOG_FILES_MAX} catalogs")
            for path in paths:
                if path not in self._read:
                    read = read_root(path)
                    # An entry may also use the parameters of the scenario.
                    self._read[path] = Node(path, read.element, read.lines, self._scope)
                found = self._read[path].find("Catalog")
                if found is not None and found.element.get("name") == name:
                    yield found


def _files(folder: Path) -> list[Path]:
    return sorted(folder.glob("*.xosc"))
