"""Reads XML from untrusted files, and checked numbers from its attributes.

The standard parser runs with expat handlers that refuse a document type declaration, and so every
entity, before it is expanded.
"""

from __future__ import annotations

import hashlib
import math
from pathlib import Path
from typing import NoReturn
from xml.etree.ElementTree import Element, TreeBuilder
from xml.parsers import expat

from iits_mj.core.errors import MapError
from iits_mj.core.input_files import similar_file

# A city of 1000 km has 60 MB; Python reads a megabyte in a second.
SIZE_LIMIT = 64 * 2**20
DEPTH_LIMIT = 64


def read_file(path: Path, size_limit: int = SIZE_LIMIT) -> bytes:
    """Reads a map file.

    Raises:
      MapError: it is missing, empty, not a regular file, unreadable or above `size_limit`.
    """
    try:
        if not path.exists():
            raise MapError(f"{path}: there is no such file{similar_file(path)}")
        if not path.is_file():
            raise MapError(f"{path}: is not a regular file; give an OpenDRIVE file (.xodr)")
        size = path.stat().st_size
        if size > size_limit:
            raise MapError(
                f"{path}: {size / 2**20:.0f} MB is too large for a map; "
                f"the limit is {size_limit / 2**20:.0f} MB"
            )
        content = path.read_bytes()
    except (OSError, ValueError) as error:
        reason = getattr(error, "strerror", None) or error
        raise MapError(f"{path}: cannot be read: {reason}") from error
    if not content.strip():
        raise MapError(f"{path}: the file is empty; an OpenDRIVE file (.xodr) is needed")
    return content


def content_hash(content: bytes) -> str:
    """Returns the SHA-256 of a file's content, in hexadecimal."""
    return hashlib.sha256(content).hexdigest()


def parse_xml(content: bytes, source: str, lines: dict[Element, int] | None = None) -> Element:
    """Parses an XML document; `source` names it in errors.

    Args:
      content: of the file.
      source: name of the file.
      lines: gets the line of each element.

    Raises:
      MapError: not well-formed, nested too deeply, or with a document type declaration.
    """
    parser = expat.ParserCreate()
    parser.buffer_text = True
    builder = TreeBuilder()
    depth = 0

    def refuse(*_: object) -> NoReturn:
        raise MapError(
            f"{source}: line {parser.CurrentLineNumber}: document type and entity declarations "
            "are refused, because they can hide an entity bomb; remove the DOCTYPE"
        )

    def start(tag: str, attributes: dict[str, str]) -> None:
        nonlocal depth
        depth += 1
        if depth > DEPTH_LIMIT:
            raise MapError(
                f"{source}: line {parser.CurrentLineNumber}: elements are nested deeper than "
                f"{DEPTH_LIMIT} levels; OpenDRIVE needs fewer than 20"
            )
        # OpenDRIVE 1.7 files may carry a default namespace; the local name is enough here.
        element = builder.start(tag.rpartition(":")[2], attributes)
        if lines is not None:
            lines[element] = parser.CurrentLineNumber

    def end(tag: str) -> None:
        nonlocal depth
        depth -= 1
        builder.end(tag.rpartition(":")[2])

    parser.StartDoctypeDeclHandler = refuse
    parser.EntityDeclHandler = refuse
    parser.StartElementHandler = start
    parser.EndElementHandler = end
    parser.CharacterDataHandler = builder.data
    try:
        parser.Parse(content, True)
    except expat.ExpatError as error:
        reason = expat.ErrorString(error.code)
        raise MapError(
            f"{source}: line {error.lineno}: is not well-formed XML: {reason}"
        ) from error
    except (LookupError, ValueError) as error:
        raise MapError(f"{source}: is not readable as XML text: {error}") from error
    return builder.close()


class Reader:
    """Reads attributes of elements; its errors name the place in the file.

    Attributes:
      place: beginning of every error message: file, road, lane.
      source: the file.
    """

    def __init__(self, place: str, source: str | None = None) -> None:
        """`source` is the place itself by default."""
        self.place = place
        self.source = place if source is None else source

    def within(self, what: str) -> Reader:
        """Returns a reader whose messages name one more level."""
        return Reader(f"{self.place}: {what}", self.source)

    def own(self, error: MapError) -> str:
        """Returns an error's message without the name of the file."""
        return str(error).removeprefix(f"{self.source}: ")

    @property
    def inside(self) -> str:
        """The place without the name of the file."""
        return self.place.removeprefix(f"{self.source}: ")

    def fail(self, message: str) -> NoReturn:
        """Raises MapError at this place."""
        raise MapError(f"{self.place}: {message}")

    def text(self, element: Element, name: str) -> str:
        """Returns an attribute as text; it must exist."""
        value = element.get(name)
        if value is None:
            self.fail(f"<{element.tag}> has no attribute {name!r}")
        return value

    def number(
        self,
        element: Element,
        name: str,
        default: float | None = None,
        low: float = -1e8,
        high: float = 1e8,
    ) -> float:
        """Returns an attribute as a finite number within [low, high]."""
        value = element.get(name)
        if value is None or (not value.strip() and default is not None):
            if default is None:
                self.fail(f"<{element.tag}> has no attribute {name!r}")
            return default
        try:
            number = float(value)
        except ValueError:
            self.fail(f"<{element.tag} {name}={value[:40]!r}> is not a number")
        if not math.isfinite(number) or not low <= number <= high:
            self.fail(
                f"<{element.tag} {name}={value[:40]!r}> is not allowed; "
                f"it must be a finite number within [{low:g}, {high:g}]"
            )
        return number

    def integer(self, element: Element, name: str) -> int:
        """Returns an attribute as an integer that fits a lane id."""
        number = self.number(element, name, low=-1000, high=1000)
        if number != int(number):
            self.fail(f"<{element.tag} {name}={element.get(name)!r}> is not a whole number")
        return int(number)
