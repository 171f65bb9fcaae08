"""Mutates bytes and texts, with a generator that is passed in."""

from __future__ import annotations

import re
from collections.abc import Sequence

import numpy as np

TOKENS = (
    *(b"nan", b"-nan", b"inf", b"-inf", b"1e308", b"-1e308", b"1e-320", b"0", b"-0", b"-1", b""),
    *(b"2147483648", b"9223372036854775808", b"1" * 400, b"true", b"null", b"[]", b"{}", b'"'),
    *(b"\x00", b"\xff\xfe", b"\xf0\x9f\x9a\x9b", b"\n", b",", b";", b"[" * 200, b"." * 60, b"<a>"),
    *(b"../../etc/passwd", b"%s%n", b"1_000", b"0x10", b"1.", b"--", b"\\", b"'" * 3),
)
_NUMBER = re.compile(rb"[-+]?\d+(?:\.\d*)?(?:[eE][-+]?\d+)?")
MOST = 2**21  # bytes of a mutant


def mutate(content: bytes, random: np.random.Generator, others: Sequence[bytes] = ()) -> bytes:
    """A changed copy: one to eight of flips, cuts, repeats, tokens, other numbers and splices."""
    for _ in range(int(random.integers(1, 9))):
        content = _STEPS[int(random.integers(len(_STEPS)))](content, random)
    if others and random.random() < 0.1:
        other = others[int(random.integers(len(others)))]
        content = content[: _place(content, random)] + other[_place(other, random) :]
    return content[:MOST]


def _place(content: bytes, random: np.random.Generator) -> int:
    return int(random.integers(len(content) + 1))


def _flip(content: bytes, random: np.random.Generator) -> bytes:
    if not content:
        return content
    changed = bytearray(content)
    changed[int(random.integers(len(changed)))] ^= 1 << int(random.integers(8))
    return bytes(changed)


def _byte(content: bytes, random: np.random.Generator) -> bytes:
    at = _place(content, random)
    return content[:at] + bytes([int(random.integers(256))]) + content[at + 1 :]


def _cut(content: bytes, random: np.random.Generator) -> bytes:
    at = _place(content, random)
    return content[:at] + content[at + int(random.integers(1, 200)) :]


def _truncate(content: bytes, random: np.random.Generator) -> bytes:
    return content[: _place(content, random)] if random.random() < 0.3 else content


def _repeat(content: bytes, random: np.random.Generator) -> bytes:
    at = _place(content, random)
    part = content[at : at + int(random.integers(1, 100))]
    return content[:at] + part * int(random.integers(2, 20)) + content[at:]


def _token(content: bytes, random: np.random.Generator) -> bytes:
    at = _place(content, random)
    return content[:at] + TOKENS[int(random.integers(len(TOKENS)))] + content[at:]


def _number(content: bytes, random: np.random.Generator) -> bytes:
    begin = _place(content, random)
    found = _NUMBER.search(content, begin)
    if found is None:
        return content
    token = TOKENS[int(random.integers(len(TOKENS)))]
    return content[: found.start()] + token + content[found.end() :]


_STEPS = (_flip, _byte, _cut, _truncate, _repeat, _token, _number, _number)
