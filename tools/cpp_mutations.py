"""Mutants of the package's C++: where they are, and sources that hold all of them.

A mutant is a small fault in one expression or statement. All mutants of a source are compiled at
once: `a - b` becomes `(mutants::On(17) ? (a + b) : (a - b))`, and a global number selects one of
them at run time (mutant schemata, Untch et al., ISSTA 1993). libclang gives the extent of each
expression.

Code that calculates is mutated: the plugin's laws and its functions that run in a step, and the
kernels. Declarations, constant expressions, and the functions that read and check a model are not.
Three kinds of changes are left out because they change no result beyond rounding: `<` to `<=`
between real numbers, a threshold of zero, and constants below 1e-5, which guard divisions.
"""

from __future__ import annotations

import itertools
import re
import subprocess
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path

from clang import cindex

PACKAGE = Path(__file__).parents[1] / "iits_mj"
GUARD = 1e-5  # constants below it guard divisions

OPPOSITE = {
    "+": "-",
    "-": "+",
    "*": "/",
    "/": "*",
    "%": "*",
    "<": ">=",
    ">=": "<",
    ">": "<=",
    "<=": ">",
    "==": "!=",
    "!=": "==",
    "&&": "||",
    "||": "&&",
    "&": "|",
    "|": "&",
    "+=": "-=",
    "-=": "+=",
    "*=": "/=",
    "/=": "*=",
}
BOUNDARY = {"<": "<=", "<=": "<", ">": ">=", ">=": ">"}
COMPARISONS = ("<", ">", "<=", ">=", "==", "!=")
KINDS = {
    **dict.fromkeys(("+", "-", "*", "/", "%", "+=", "-=", "*=", "/="), "arithmetic"),
    **dict.fromkeys(COMPARISONS, "comparison"),
    **dict.fromkeys(("&&", "||", "&", "|"), "logic"),
}

K = cindex.CursorKind
BODIES = (K.COMPOUND_STMT, K.IF_STMT, K.FOR_STMT, K.WHILE_STMT, K.CXX_FOR_RANGE_STMT)
ASSIGNMENTS = ("=", "+=", "-=", "*=", "/=")


@dataclass(frozen=True)
class Library:
    """A compiled library of the package.

    Attributes:
      folder: of the sources, below `iits_mj`.
      variable: environment variable that names another build of it.
      bounds: functions that a mutant of Min, Max and Clamp calls.
      functions: regular expression of functions that read, check or describe a model.
      files: files of nothing else.
    """

    folder: str
    variable: str
    bounds: tuple[str, str]
    functions: str = ""
    files: tuple[str, ...] = ()

    @property
    def name(self) -> str:
        """File name of the library."""
        return f"libiits_mj_{self.folder}.so"

    def sources(self) -> list[Path]:
        """The files that are mutated, in a fixed order."""
        folder = PACKAGE / self.folder
        files = (
            sorted(folder.glob("*/*.[ch]*")),
            sorted([*folder.glob("*.cc"), *folder.glob("*.h")]),
        )
        return [path for path in itertools.chain(*files) if path.name not in self.files]


PLUGIN = Library(
    "plugin",
    "IITS_MJ_PLUGIN",
    ("iits::Min", "iits::Max"),
    r"Table|Check|Find\w*|Register\w*|SensorSize|StateCount|Place|Pressure",
    ("attributes.cc", "attributes.h", "plugin.cc", "plugin.h"),
)
KERNELS = Library("kernels", "IITS_MJ_KERNELS", ("std::min", "std::max"))


@dataclass(frozen=True)
class Mutant:
    """A change of one expression or statement."""

    file: str  # below iits_mj
    line: int
    at: int  # column in the line without its indentation
    operator: str
    original: str
    mutant: str
    source: str  # the line
    start: int  # range of the file, and what replaces it
    end: int
    text: str
    number: int = 0

    @property
    def key(self) -> tuple[str, str, str, str, str]:
        """Identifies the mutant also after lines have moved."""
        return self.file, self.source, str(self.at), self.original, self.mutant


def include_flags() -> list[str]:
    """The compiler's flags for the headers of the package and of MuJoCo."""
    import importlib.util

    spec = importlib.util.find_spec("mujoco")
    assert spec is not None
    assert spec.submodule_search_locations
    return [f"-I{PACKAGE}", f"-I{Path(spec.submodule_search_locations[0]) / 'include'}"]


def find(path: Path, library: Library) -> list[Mutant]:
    """Returns the mutants of a source in the order of their places."""
    listing = subprocess.run(
        ["c++", "-E", "-x", "c++", "-", "-v"], input="", capture_output=True, text=True, check=True
    ).stderr
    folders = listing.split("search starts here:")[-1].split("End of search")[0].split()
    flags = ["-x", "c++", "-std=c++17", *include_flags(), *(f"-isystem{f}" for f in folders)]
    unit = cindex.Index.create().parse(str(path), args=flags)
    errors = [str(d) for d in unit.diagnostics if d.severity >= cindex.Diagnostic.Error]
    if errors:
        raise RuntimeError(f"{path} cannot be parsed: {errors[0]}")
    return _Finder(path, library).run(unit.cursor)


class _Finder:
    """Walks the syntax tree of one source."""

    def __init__(self, path: Path, library: Library) -> None:
        self.path, self.library = path, library
        self.code = path.read_bytes().decode("latin-1")  # a character is a byte of an extent
        self.file = f"{library.folder}/{path.relative_to(PACKAGE / library.folder)}"
        self.found: list[Mutant] = []
        # Constants of the file; their declaration cannot change at run time, but their uses can.
        self.constants = {
            name: value
            for names in re.findall(r"constexpr double (k\w+ = [^;]+);", self.code)
            for name, value in re.findall(r"(k\w+) = ([^,;]+)", names)
        }

    def run(self, root: cindex.Cursor) -> list[Mutant]:
        for child in root.get_children():
            if child.location.file and child.location.file.name == str(self.path):
                self.walk(child, [])
        return sorted(set(self.found), key=lambda m: (m.start, m.end, m.operator, m.mutant))

    def text(self, node: cindex.Cursor) -> str:
        return self.code[node.extent.start.offset : node.extent.end.offset]

    def add(
        self, node: cindex.Cursor, operator: str, original: str, mutant: str, text: str
    ) -> None:
        start, end = node.extent.start.offset, node.extent.end.offset
        line_start = self.code.rfind("\n", 0, start) + 1
        source = self.code[line_start : self.code.find("\n", start)]
        at = start - line_start - (len(source) - len(source.lstrip()))
        line = node.extent.start.line
        before, after = (" ".join(x.split()) for x in (original, mutant))
        self.found.append(
            Mutant(self.file, line, at, operator, before, after, source.strip(), start, end, text)
        )

    def walk(self, node: cindex.Cursor, parents: list[cindex.Cursor]) -> None:
        if self.excluded(node):
            return
        if node.kind in (K.BINARY_OPERATOR, K.COMPOUND_ASSIGNMENT_OPERATOR):
            self.binary(node)
        elif node.kind == K.UNARY_OPERATOR and self.text(node)[0] in "-!":
            inside = self.text(node)[1:]
            self.add(node, "sign", self.text(node), inside, inside)
        elif node.kind == K.CALL_EXPR:
            self.extremum(node)
        elif node.kind in (K.INTEGER_LITERAL, K.FLOATING_LITERAL):
            self.literal(node, parents)
        elif node.kind == K.DECL_REF_EXPR:
            self.constant(node)
        if node.kind in (K.IF_STMT, K.CONDITIONAL_OPERATOR):
            self.condition(next(node.get_children()))
        if node.kind in BODIES:
            self.statements(node)
        children = list(node.get_children())
        if node.kind == K.IF_STMT and "Refuse(" in self.text(children[1]):
            children = children[2:]
        if node.kind == K.ARRAY_SUBSCRIPT_EXPR and children[1].kind == K.INTEGER_LITERAL:
            children = children[:1]
        for child in children:
            self.walk(child, [*parents, node])

    def excluded(self, node: cindex.Cursor) -> bool:
        text = self.text(node)
        if node.kind in (K.FUNCTION_DECL, K.CXX_METHOD, K.FUNCTION_TEMPLATE):
            skipped = re.fullmatch(self.library.functions, node.spelling)
            return bool(skipped) or "constexpr" in text.split("(")[0]
        if node.kind in (K.DECL_STMT, K.VAR_DECL):
            return bool(re.match(r"(static |inline |const )*constexpr", text))
        if node.kind == K.IF_STMT:
            return text.startswith("if constexpr")
        kinds = (K.STATIC_ASSERT, K.FIELD_DECL, K.ENUM_DECL, K.TYPE_ALIAS_DECL, K.STRING_LITERAL)
        return node.kind in kinds or text.startswith("Refuse(")

    def operator(self, node: cindex.Cursor) -> tuple[str, str, str]:
        """Left side, operator, right side."""
        left, right = list(node.get_children())[:2]
        start, end = left.extent.end.offset, right.extent.start.offset
        operator = re.sub(r"//.*", "", self.code[start:end]).strip()
        return self.text(left), operator, self.text(right)

    def binary(self, node: cindex.Cursor) -> None:
        left, operator, right = self.operator(node)
        if operator not in OPPOSITE:
            return
        changes = [OPPOSITE[operator]]
        kinds = [c.type.get_canonical().kind for c in node.get_children()]
        whole = [cindex.TypeKind.INT, cindex.TypeKind.ULONG, cindex.TypeKind.UINT]
        if operator in BOUNDARY and all(kind in whole for kind in kinds):
            changes.append(BOUNDARY[operator])
        for change in changes:
            whole_text = f"{left} {change} {right}"
            self.add(node, KINDS[operator], f"{left} {operator} {right}", whole_text, whole_text)

    def extremum(self, node: cindex.Cursor) -> None:
        """Drops a bound of Min, Max and Clamp, or exchanges Min and Max."""
        name = re.match(r"(?:std::)?([Mm]in|[Mm]ax|[Cc]lamp|Clip|mju_clip)\(", self.text(node))
        arguments = [self.text(a) for a in list(node.get_children())[1:]]
        if not name or any("[" in a and "](" in a for a in arguments):
            return
        function = name[1].capitalize()
        least, most = self.library.bounds
        if function in ("Clamp", "Clip", "Mju_clip") and len(arguments) == 3:
            x, low, high = arguments
            changes = [x, f"{most}({x}, {low})", f"{least}({x}, {high})"]
        elif len(arguments) == 2:
            other = most if function == "Min" else least
            changes = [*arguments, f"{other}({', '.join(arguments)})"]
        else:
            return
        for change in changes:
            text = f"mutants::As({self.text(node)}, {change})"
            self.add(node, "bound", self.text(node), change, text)

    def literal(self, node: cindex.Cursor, parents: list[cindex.Cursor]) -> None:
        text = self.text(node)
        before = self.code[: node.extent.start.offset].rstrip()[-1]
        if not re.match(r"[\d.]", text) or before in "[" or text.lower().startswith("0x"):
            return
        digits = text.rstrip("uUlL")
        value, suffix = float(digits), text.removeprefix(digits)
        near = next((p for p in reversed(parents) if p.kind != K.UNEXPOSED_EXPR), node)
        if value == 0:
            compared = near.kind == K.BINARY_OPERATOR and self.operator(near)[1] in COMPARISONS
            bound = near.kind == K.CALL_EXPR and re.match(r"Min|Max|Clamp", self.text(near))
            if not compared and not bound:
                self.add(node, "constant", text, f"1{suffix}", f"1{suffix}")
        elif node.kind == K.INTEGER_LITERAL:
            more = f"{int(value) + 1}{suffix}"
            self.add(node, "constant", text, more, more)
        elif abs(value) >= GUARD:
            self.add(node, "constant", text, f"{1.5 * value:g}", f"{1.5 * value!r}")

    def constant(self, node: cindex.Cursor) -> None:
        name = self.text(node)
        value = self.constants.get(name, "0")
        if name in self.constants and not re.fullmatch(r"1e-(\d\d|[6-9])", value):
            self.add(node, "constant", name, f"1.5 * {name}", f"1.5 * {name}")

    def condition(self, node: cindex.Cursor) -> None:
        """Negates a condition that has no operator of its own."""
        text = self.text(node)
        if node.kind == K.BINARY_OPERATOR or text.startswith("!") or not text:
            return
        self.add(node, "condition", text, f"!({text})", f"!({text})")

    def statements(self, node: cindex.Cursor) -> None:
        """Drops assignments and calls that stand as statements."""
        children = list(node.get_children())
        if node.kind == K.FOR_STMT:
            children = children[-1:]
        elif node.kind != K.COMPOUND_STMT:
            children = children[1:]
        for child in children:
            kind, text = child.kind, self.text(child)
            while kind == K.UNEXPOSED_EXPR:
                child = next(child.get_children())
                kind = child.kind
            assigns = kind == K.COMPOUND_ASSIGNMENT_OPERATOR or (
                kind == K.BINARY_OPERATOR and self.operator(child)[1] in ASSIGNMENTS
            )
            if (assigns or kind == K.CALL_EXPR) and not text.startswith("Refuse("):
                self.add(child, "dropped", text, "", "")


def number(mutants: list[Mutant]) -> list[Mutant]:
    """Numbers the mutants from 1 on."""
    return [replace(mutant, number=i) for i, mutant in enumerate(mutants, 1)]


def render(code: str, mutants: list[Mutant]) -> tuple[str, dict[int, tuple[int, int]]]:
    """Returns the source with a switch at each mutant, and where the text of each one stands."""
    places: dict[int, tuple[int, int]] = {}
    by_range: dict[tuple[int, int], list[Mutant]] = {}
    for mutant in mutants:
        by_range.setdefault((mutant.start, mutant.end), []).append(mutant)
    ranges = sorted(by_range, key=lambda r: (r[0], -r[1]))
    out: list[str] = ["\n"]
    length = 1

    def put(text: str) -> None:
        nonlocal length
        out.append(text)
        length += len(text)

    def fill(start: int, end: int, inner: list[tuple[int, int]]) -> None:
        at = start
        while inner:
            first, *inner = inner
            put(code[at : first[0]])
            within = [r for r in inner if r[1] <= first[1]]
            inner = [r for r in inner if r[1] > first[1]]
            switch(first, within)
            at = first[1]
        put(code[at:end])

    def switch(place: tuple[int, int], within: list[tuple[int, int]]) -> None:
        drops = any(mutant.operator == "dropped" for mutant in by_range[place])
        put("(")
        for mutant in by_range[place]:
            begin = length
            put(f"\nmutants::On({mutant.number}) ? ")
            put("void()" if not mutant.text else f"{'void' if drops else ''}({mutant.text})")
            put("\n: ")
            places[mutant.number] = begin, length
        put("void(" if drops else "(")
        fill(*place, within)
        put("))")

    fill(0, len(code), ranges)
    return "".join(out), places


def blamed(errors: str, path: Path, places: dict[int, tuple[int, int]]) -> Iterator[int]:
    """The mutants whose text the compiler's errors in `path` point to."""
    text = path.read_bytes().decode("latin-1")
    starts = [0]
    for line in text.split("\n"):
        starts.append(starts[-1] + len(line) + 1)
    for line, column in re.findall(rf"{re.escape(str(path))}:(\d+):(\d+):", errors):
        offset = starts[int(line) - 1] + int(column) - 1
        around = [n for n, (begin, end) in places.items() if begin <= offset < end]
        if around:
            yield min(around, key=lambda n: places[n][1] - places[n][0])
