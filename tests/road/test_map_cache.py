"""Maps and routes that come from the cache equal those that are read and searched."""

from __future__ import annotations

import os
import pickle
from pathlib import Path

import numpy as np
import pytest

from iits_mj.core.cache import read_sealed, write_sealed
from iits_mj.road import RoadMap, map_cache, opendrive, route
from iits_mj.road.map_cache import MapCache
from tests.road.opendrive_text import document, line, road, successor


class Trap:
    """Runs code where a pickle of it is loaded without care."""

    def __init__(self, target: Path) -> None:
        self.target = target

    def __reduce__(self):
        return os.mkdir, (str(self.target),)


@pytest.fixture
def cache(tmp_path, monkeypatch) -> Path:
    monkeypatch.setenv("IITS_MJ_CACHE", str(tmp_path / "cache"))
    monkeypatch.setattr(route, "SIZE_MIN", 0)
    map_cache._code_digest.cache_clear()
    return tmp_path / "cache" / "maps"


@pytest.fixture
def path(tmp_path) -> Path:
    file = tmp_path / "two.xodr"
    file.write_text(document(road(link=successor("2")), road("2", line(100.0))))
    return file


@pytest.fixture
def parsed(monkeypatch) -> list[str]:
    """The names of the maps that are parsed from here on."""
    names: list[str] = []

    def counted(content: bytes, source: str):
        names.append(source)
        return opendrive.parse(content, source)

    monkeypatch.setattr(route, "parse", counted)
    return names


def searched(monkeypatch) -> list[str | None]:
    starts: list[str | None] = []
    original = RoadMap._search

    def counted(self, start, *values):
        starts.append(start)
        return original(self, start, *values)

    monkeypatch.setattr(RoadMap, "_search", counted)
    return starts


def test_a_map_read_again_is_neither_parsed_nor_searched_and_has_the_same_bits(
    cache, path, parsed, monkeypatch
):
    starts = searched(monkeypatch)
    first = RoadMap.from_opendrive(path)
    driven = first.route()
    again = RoadMap.from_opendrive(path)
    found = again.route()
    assert parsed == [str(path)]
    assert starts == [None]
    assert again.content == first.content
    assert again.notes == first.notes
    assert np.array_equal(found.table(), driven.table())
    assert found.road_map is again
    assert found.chain.pieces[0].road is again.roads[driven.chain.pieces[0].road.id]
    assert again.route("2").segments == first.route("2").segments


@pytest.mark.parametrize("damage", ["cut", "other", "empty"])
def test_a_damaged_file_is_made_again(cache, path, parsed, damage):
    whole = RoadMap.from_opendrive(path).content
    (file,) = cache.iterdir()
    content = file.read_bytes()
    file.write_bytes({"cut": content[:-9], "other": content[:-1] + b"x", "empty": b""}[damage])
    assert RoadMap.from_opendrive(path).content == whole
    assert len(parsed) == 2
    assert read_sealed(file) is not None


def test_another_content_or_another_code_is_read_again(cache, path, parsed, monkeypatch):
    RoadMap.from_opendrive(path)
    path.write_text(document(road("1", line(0.0, length=150.0), 150.0)))
    assert RoadMap.from_opendrive(path).roads["1"].length == 150.0
    monkeypatch.setattr(map_cache, "_code_digest", lambda: "newer")
    RoadMap.from_opendrive(path)
    assert len(parsed) == 3


def test_a_file_of_the_cache_cannot_run_code(cache, path, tmp_path, parsed):
    RoadMap.from_opendrive(path)
    (file,) = cache.iterdir()
    write_sealed(file, pickle.dumps(Trap(tmp_path / "made")), 10)
    RoadMap.from_opendrive(path)
    assert not (tmp_path / "made").exists()
    assert len(parsed) == 2


def test_without_a_cache_that_can_be_written_the_map_is_read(path, parsed, cache, monkeypatch):
    monkeypatch.setenv("IITS_MJ_CACHE", str(path / "below_a_file"))
    for _ in range(2):
        assert RoadMap.from_opendrive(path).route().length > 0.0
    assert len(parsed) == 2


def test_the_oldest_files_are_removed(tmp_path):
    for number in range(5):
        write_sealed(tmp_path / f"{number}.bin", b"body", 3)
        os.utime(tmp_path / f"{number}.bin", (number, number))
    assert sorted(file.name for file in tmp_path.iterdir()) == ["2.bin", "3.bin", "4.bin"]


def test_a_result_names_shared_objects_instead_of_containing_them(cache):
    shared = {"map": object()}
    kept = MapCache("0" * 64, "m.xodr")
    kept.keep("route", [shared["map"], 1.5], shared)
    found = kept.recall("route", shared)
    assert found[0] is shared["map"]
    assert found[1] == 1.5
    assert kept.recall("route") is None
