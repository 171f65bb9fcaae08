"""Parts of a drive that a user may replace, such as its decision maker.

A part is given as the name of a shipped one; as text, `FILE.py:NAME` or `MODULE:NAME`, that names a
class, a function that makes the part, or an object; or, in Python, as such a class, function or
object itself. Options may follow a text: `my.py:Mine:gain=2:side=left` calls
`Mine(gain=2, side="left")`. Their values are read as in TOML; everything else is text. Some shipped
parts take options, too: `lookahead:horizon=30:change_cost=25`, where a comma may replace a colon.

A `Kind` finds, checks and makes parts, and a `Guard` calls a user's part in a drive. Both refuse
what does not fit with one `InputError` that names the part.
"""

from __future__ import annotations

import dataclasses
import functools
import hashlib
import importlib
import inspect
import os
import re
import sys
import tomllib
import traceback
import types
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any, ClassVar

from iits_mj.core.checks import did_you_mean, is_number, shown
from iits_mj.core.errors import Error, InputError

# Packages whose classes are parts that need no guard.
_OURS = ("controllers", "iits_mj", "traffic_bridge")
_SOURCE = "__iits_mj_source__"
FORMS = "FILE.py:NAME or MODULE:NAME, options after it as :KEY=VALUE"
# The file of each part in a text, which may name several parts with commas between them.
FILES = re.compile(r"(?<![^,])[^:,]+\.py(?=:)")
# Name or text; a class, function or object that fits a protocol.
AnyPart = str | object


@dataclass(frozen=True)
class Kind:
    """A kind of part.

    Attributes:
      name: for messages.
      protocol: whose methods a part must have.
      shipped: names of the shipped parts.
      maker: class of a shipped part that takes options, a dataclass whose fields have defaults, by
        the part's name; None for a part without options.
    """

    name: str
    protocol: type
    shipped: tuple[str, ...]
    maker: Callable[[str], type[Any] | None] = lambda _: None

    def check(self, value: Any) -> None:
        """Checks a part that was given, without making it.

        Raises:
          InputError: it names neither a shipped part nor an own one, or does not fit.
        """
        if not self.is_own(value):
            self._tuned(value)
        else:
            found, options = self._find(value)
            if _makes(found):
                self._bind(found, options, part_name(found))
            elif options:
                raise InputError(f"{self.name} {value} is an object: it takes no options")
            if isinstance(found, type) or not _makes(found):
                self.require(found)

    def make(self, value: Any, **offered: Any) -> Any:
        """Returns a user's part, for its guard, or a shipped one with the options that it has.

        It is None if a shipped one is named without options.

        Args:
          value: the part that was given.
          **offered: arguments of which a class or function gets those that its signature names.

        Raises:
          InputError: see `check`; or it cannot be made.
        """
        if not self.is_own(value):
            return self._tuned(value)
        found, options = self._find(value)
        if _makes(found):
            name = part_name(found)
            keywords = self._bind(found, options, name, offered)
            found = call(f"{self.name} {name}", "construction", found, **keywords)
        return found

    def is_own(self, value: Any) -> bool:
        """Returns whether a part is the user's own.

        Raises:
          InputError: it is the name of no shipped part.
        """
        if not isinstance(value, str):
            return True
        name, options, _ = value.partition(":")
        if name in self.shipped:
            return False
        if not options:
            near = did_you_mean(value, self.shipped)
            raise InputError(
                f"{self.name} {value!r} is not known{near}; use one of: {', '.join(self.shipped)}; "
                f"or your own as {FORMS}"
            )
        return True

    def normal_name(self, value: str) -> str:
        """Returns the text of a part, the same for each way to write a shipped part's options.

        It has the options that differ from their defaults, in the order of the part's fields. An
        own part's text stays as it is.

        Raises:
          InputError: see `check`.
        """
        part = None if self.is_own(value) else self._tuned(value)
        if part is None:
            return value
        given = {f.name: getattr(part, f.name) for f in dataclasses.fields(part)}
        words = [
            f"{f.name}={str(given[f.name]).removesuffix('.0')}"
            for f in dataclasses.fields(part)
            if given[f.name] != f.default
        ]
        return ":".join((value.partition(":")[0], *words))

    def _tuned(self, value: str) -> Any:
        """Returns a shipped part with its options; None for a name without options."""
        name, colon, text = value.partition(":")
        if not colon:
            return None
        made_by = self.maker(name)
        if made_by is None:
            raise InputError(f"{self.name} {value!r}: {name!r} is a shipped one, without options")
        try:
            options = _options(re.split("[:,]", text))
            self._bind(made_by, options, name)
            return made_by(**options)
        except InputError as error:
            about = "" if str(error).startswith(self.name) else f"{self.name} {value!r}: "
            raise InputError(f"{about}{error}") from error

    def _find(self, value: Any) -> tuple[Any, dict[str, Any]]:
        """Returns the class, function or object that was given, and the options."""
        if not isinstance(value, str):
            return value, {}
        place, name, *words = value.split(":")
        try:
            module = _module(place)
            found = module
            for part in name.split("."):
                if not hasattr(found, part):
                    names = [each for each in dir(found) if not each.startswith("_")]
                    where = "" if found is module else f".{name.partition('.')[0]}"
                    raise InputError(f"{place}{where} has no {part!r}{did_you_mean(part, names)}")
                found = getattr(found, part)
            return found, _options(words)
        except InputError as error:
            near = "" if "did you mean" in str(error) else did_you_mean(place, self.shipped)
            raise InputError(f"{self.name} {value!r}: {error}{near}") from error.__cause__

    def _bind(
        self,
        made_by: Any,
        options: dict[str, Any],
        name: str,
        offered: dict[str, Any] | None = None,
    ) -> dict[str, Any]:
        """Returns the keyword arguments for a class or function.

        Without `offered`, only the names of the options are checked.

        Raises:
          InputError: it has no argument of an option's name, or one gets no value.
        """
        try:
            parameters = inspect.signature(made_by).parameters
        except (TypeError, ValueError):
            return options
        takes = [n for n, p in parameters.items() if p.kind in _BY_NAME]
        free = any(p.kind is p.VAR_KEYWORD for p in parameters.values())
        for option in options:
            if option not in takes and not free:
                near, has = did_you_mean(option, takes), ", ".join(takes) or "none"
                raise InputError(
                    f"{self.name} {name} has no argument {option!r}{near}; it has {has}"
                )
        if offered is None:
            return options
        keywords = {n: v for n, v in offered.items() if n in takes} | options
        for n, p in parameters.items():
            if p.default is p.empty and n not in keywords and p.kind not in _ANY:
                raise InputError(
                    f"{self.name} {name} needs an argument {n!r}, which the drive does not offer: "
                    f"add it as an option, {name}:{n}=VALUE; offered are {', '.join(offered)}"
                )
        return keywords

    def require(self, part: Any) -> None:
        """Raises InputError unless a class or object has all methods with fitting signatures."""
        title = f"{self.name} {part_name(part)}"
        wanted = {
            name: method
            for name, method in vars(self.protocol).items()
            if inspect.isfunction(method) and not name.startswith("_")
        }
        lacks, similar = [], ""
        for name, method in wanted.items():
            found = getattr(part, name, None)
            # A method of the protocol itself is only its description.
            if not callable(found) or getattr(found, "__func__", found) is method:
                lacks.append(f"{name}({', '.join(_arguments(method))})")
                similar = similar or did_you_mean(name, {n for n in dir(part) if n not in wanted})
        if lacks:
            raise InputError(f"{title} lacks {' and '.join(lacks)}{similar}")
        for name, method in wanted.items():
            found, arguments = getattr(part, name), _arguments(method)
            unbound = isinstance(part, type) and inspect.isfunction(found)
            if unbound and isinstance(inspect.getattr_static(part, name), staticmethod):
                unbound = False
            try:
                signature = inspect.signature(found)
            except (TypeError, ValueError):
                continue
            try:
                signature.bind(*([None] * unbound), *arguments)
            except TypeError:
                raise InputError(
                    f"{title}: {name}{signature} must take ({', '.join(arguments)})"
                ) from None


_BY_NAME = (inspect.Parameter.POSITIONAL_OR_KEYWORD, inspect.Parameter.KEYWORD_ONLY)
_ANY = (inspect.Parameter.VAR_POSITIONAL, inspect.Parameter.VAR_KEYWORD)


class Guard:
    """Base of guards: calls a user's part; faults become an `InputError` with the part's name.

    Other attributes are those of the part.

    Args:
      part: of the user.

    Attributes:
      kind: of the part; part: as given; title: kind and name of it for messages.

    Raises:
      InputError: the part lacks a method.
    """

    kind: ClassVar[Kind]

    def __init__(self, part: Any) -> None:
        self.kind.require(part)
        self.part = part
        self.title = f"{self.kind.name} {part_name(part)}"

    def __getattr__(self, name: str) -> Any:
        # Without this, a copy that has no attributes yet would look for them without end.
        if name == "part" or name.startswith("__"):
            raise AttributeError(name)
        return getattr(self.part, name)

    def call(self, method: str, *arguments: Any) -> Any:
        """Returns the result of a method of the part.

        Raises:
          InputError: the part raised an exception that is not an `Error`.
        """
        return call(self.title, method, getattr(self.part, method), *arguments)

    def number(self, method: str, *arguments: Any) -> float:
        """Returns the result of a method that must be one finite number."""
        value = self.call(method, *arguments)
        if not is_number(value):
            raise self.unusable(method, f"returned {shown(value)}, must return a finite number")
        return float(value)

    def unusable(self, method: str, reason: str) -> InputError:
        """Returns the error about a result."""
        return InputError(f"{self.title}: {method} {reason}")


def is_own(part: Any) -> bool:
    """Returns whether a part is a user's, not of this package."""
    return type(part).__module__.partition(".")[0] not in _OURS


def call(title: str, what: str, function: Callable[..., Any], *arguments: Any, **more: Any) -> Any:
    """Returns the result of a user's function.

    Raises:
      InputError: the function raised an exception that is not an `Error`; names its place.
    """
    try:
        return function(*arguments, **more)
    except Error:
        raise
    except Exception as error:
        # Behind this function comes the user's, which may have failed in a library.
        frames = traceback.extract_tb(error.__traceback__)[1:]
        own = [f for f in frames if f.filename == frames[0].filename]
        place = f" ({Path(own[-1].filename).name}, line {own[-1].lineno})" if own else ""
        fault = f"{type(error).__name__}: {error}{place}"
        raise InputError(f"{title}: {what} failed: {fault}") from error


def part_name(part: Any) -> str:
    """Returns the name of a part: a text as it is; else MODULE:NAME or FILE.py:NAME of its class.

    The name of an object leads to its class, not to what the object holds.
    """
    if isinstance(part, str):
        return part
    named = _named(part)
    place = named.__module__
    if place == "__main__":
        # A script run by Python is a file that can be named.
        place = getattr(sys.modules[place], "__file__", None) or place
    if place.endswith(".py"):
        inside = os.path.relpath(place)
        place = place if inside.startswith("..") else inside
    return f"{place}:{named.__qualname__}"


def _named(part: Any) -> Any:
    """Returns the class or function of a part that is no text."""
    if isinstance(part, functools.partial):
        return _named(part.func)
    return part if isinstance(part, type) or inspect.isroutine(part) else type(part)


def source_digest(part: Any) -> str:
    """Returns 12 hexadecimal digits of the file that defines a user's part.

    It is "" for a shipped part, and for one that no file defines.

    Raises:
      InputError: the text does not lead to a module.
    """
    if isinstance(part, str):
        if ":" not in part:
            return ""
        place = part_name(part).split(":")[0]
        name = str(Path(place).expanduser().resolve()) if place.endswith(".py") else place
        module = sys.modules.get(name) or _module(place)
    else:
        module = sys.modules[_named(part).__module__]
    # The file may have changed since it was read.
    source, file = getattr(module, _SOURCE, None), getattr(module, "__file__", None)
    if source is None:
        source = Path(file).read_bytes() if file is not None and Path(file).is_file() else b""
    return hashlib.sha256(source).hexdigest()[:12] if source else ""


def _makes(found: Any) -> bool:
    """Returns whether a class or function makes a part, instead of being one."""
    return isinstance(found, (type, functools.partial)) or inspect.isroutine(found)


def _arguments(method: Any) -> list[str]:
    """Returns the names of a protocol's arguments without `self`."""
    return list(inspect.signature(method).parameters)[1:]


def _options(words: list[str]) -> dict[str, Any]:
    """Returns the values of options by their keys."""
    options = dict(map(_option, words))
    if len(options) < len(words):
        keys = [word.partition("=")[0] for word in words]
        twice = next(key for key in keys if keys.count(key) > 1)
        raise InputError(f"option {twice!r} is given twice")
    return options


def _option(word: str) -> tuple[str, Any]:
    """Returns key and value of KEY=VALUE."""
    key, equals, text = word.partition("=")
    if not equals or not key.isidentifier():
        raise InputError(f"option {word!r} must be KEY=VALUE")
    try:
        return key, tomllib.loads(f"value = {text}")["value"]
    except tomllib.TOMLDecodeError:
        return key, text


def _module(place: str) -> types.ModuleType:
    """Returns the module of a file or of a dotted name.

    Modules are also found in the current folder, after all others; those that a file imports, in
    its folder, too.
    """
    if "\0" in place:
        raise InputError(f"{place!r} is not the name of a file or module")
    if place.endswith(".py"):
        return _file(Path(place).expanduser().resolve(), place)
    if not all(part.isidentifier() for part in place.split(".")):
        raise InputError(f"{place!r} is not the name of a module, nor a file that ends in .py")
    _search(Path.cwd())
    try:
        return importlib.import_module(place)
    except ModuleNotFoundError as error:
        if error.name is None or not (place == error.name or place.startswith(f"{error.name}.")):
            raise _broken(place, error) from error
        near = "" if "." in place else did_you_mean(f"{place}.py", _files(Path.cwd()))
        raise InputError(f"there is no module {error.name!r}{near}") from error
    except (Exception, SystemExit) as error:
        raise _broken(place, error) from error


def _file(path: Path, place: str) -> types.ModuleType:
    """Returns the module of a file; reads it again after a change."""
    try:
        source = path.read_bytes()
    except OSError as error:
        near = did_you_mean(path.name, _files(path.parent))
        raise InputError(f"file {place!r} cannot be read: {error.strerror}{near}") from error
    name = str(path)
    known = sys.modules.get(name)
    if known is not None and getattr(known, _SOURCE, None) == source:
        return known
    _search(path.parent)
    module = types.ModuleType(name)
    module.__file__ = name
    setattr(module, _SOURCE, source)
    sys.modules[name] = module
    try:
        exec(compile(source, name, "exec"), module.__dict__)
    except (Exception, SystemExit) as error:
        del sys.modules[name]
        raise _broken(place, error) from error
    return module


def _broken(place: str, error: BaseException) -> InputError:
    frames = traceback.extract_tb(error.__traceback__)
    line = error.lineno if isinstance(error, SyntaxError) else frames[-1].lineno
    return InputError(f"{place} cannot be imported: {type(error).__name__}: {error} (line {line})")


def _search(folder: Path) -> None:
    """Adds a folder to the end of the places where Python looks for modules."""
    if str(folder) not in sys.path:
        sys.path.append(str(folder))


def _files(folder: Path) -> list[str]:
    """Returns the names of the Python files in a folder."""
    return [path.name for path in folder.glob("*.py") if path.is_file()]
