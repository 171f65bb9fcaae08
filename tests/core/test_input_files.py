"""Hostile TOML, JSON and npz files are refused quickly, by name, and without filling the memory."""

from __future__ import annotations

import json
import resource
import zipfile
from pathlib import Path

import numpy as np
import pytest

from iits_mj.core.errors import InputError
from iits_mj.core.input_files import read_json, read_npz, read_toml

DEEP = {
    "arrays": "x = " + "[" * 100_000,
    "closed arrays": "x = " + "[" * 500 + "]" * 500,
    "inline tables": "x = " + "{a = " * 5_000,
    "dotted key": ".".join("a" * 200_000) + " = 1",
    "quoted key": ".".join(['"a b"'] * 100_000) + " = 1",
    "header": "[" + " . ".join("a" * 200_000) + "]",
    "key in a table": "x = { " + ".".join("a" * 50_000) + " = 1 }",
}


@pytest.mark.parametrize("text", DEEP.values(), ids=DEEP)
def test_deeply_nested_toml_is_refused(tmp_path: Path, text: str) -> None:
    path = tmp_path / "deep.toml"
    path.write_text(text)
    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    with pytest.raises(InputError, match=r"overlay .*deep.toml. cannot be read: .*nested deeper"):
        read_toml(path, "overlay")
    assert resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before < 200_000  # KiB


def test_long_numbers_sentences_and_32_levels_of_toml_are_read(tmp_path: Path) -> None:
    path = tmp_path / "table.toml"
    numbers = ", ".join(["1.5"] * 5_000)
    key = ".".join("a" * 31)
    path.write_text(f'x = [{numbers}]\ns = "A sentence. {"And one more. " * 50}"\n{key} = 1\n')
    assert len(read_toml(path, "overlay")["x"]) == 5_000


def test_toml_beyond_the_size_limit_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "long.toml"
    path.write_text("#" * (4 * 2**20 + 1))
    with pytest.raises(InputError, match="4194305 bytes are more than 4194304 allowed"):
        read_toml(path, "overlay")


@pytest.mark.parametrize(
    "text", ["[" * 100_000, json.dumps([[]]).replace("[]", "[" * 40 + "]" * 40)]
)
def test_deeply_nested_json_is_refused(text: str) -> None:
    with pytest.raises(InputError, match="weights: metadata is nested deeper than 32 levels"):
        read_json(text, "weights: metadata")


def write_npz(path: Path, **arrays: bytes) -> Path:
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
        for name, content in arrays.items():
            archive.writestr(f"{name}.npy", content)
    return path


def header(shape: str) -> bytes:
    text = f"{{'descr': '<f8', 'fortran_order': False, 'shape': {shape}, }}".ljust(117) + "\n"
    return b"\x93NUMPY\x01\x00" + len(text).to_bytes(2, "little") + text.encode()


def test_a_file_that_unpacks_to_gigabytes_is_refused_before_it_is_read(tmp_path: Path) -> None:
    count = 8 * 2**20
    path = write_npz(tmp_path / "bomb.npz", x=header(f"({count},)") + bytes(8 * count))
    assert path.stat().st_size < 2**17
    with pytest.raises(InputError, match=r"bomb.npz': its arrays have 67108\d+ bytes unpacked"):
        read_npz(path, "recording", 2**25, ["x"])


@pytest.mark.parametrize("shape", ["(10**12,)", "(1000000000000,)", "(3,)", "(-1,)", "(2, 2)"])
def test_an_array_of_another_size_than_its_header_says_is_refused(
    tmp_path: Path, shape: str
) -> None:
    path = write_npz(tmp_path / "wrong.npz", x=header(shape) + bytes(16))
    with pytest.raises(InputError, match=r"recording .*wrong.npz': cannot be read"):
        read_npz(path, "recording", 2**20, ["x"])


def test_arrays_that_are_not_asked_for_are_not_read(tmp_path: Path) -> None:
    path = tmp_path / "more.npz"
    np.savez_compressed(path, x=np.arange(3.0), other=np.zeros(2**24))
    assert read_npz(path, "recording", 2**20, ["x"], ["y"])["x"].tolist() == [0.0, 1.0, 2.0]
    with pytest.raises(InputError, match=r"more.npz' lacks y, z"):
        read_npz(path, "recording", 2**20, ["x", "y", "z"])
