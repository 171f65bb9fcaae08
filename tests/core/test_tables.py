"""Columns of numbers from CSV files."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pytest

from controllers.pcc import RoadProfile
from controllers.planning.speed_reference import read_profile
from iits_mj.core.errors import InputError
from iits_mj.core.tables import read_columns, read_names, read_rows
from iits_mj.road.measured import route_from_csv
from iits_mj.validation.planning.pcc_roads import read_cycle

NAMES = (("s_m", "s"), ("z_m", "z"))


def write(tmp_path, text):
    path = tmp_path / "table.csv"
    path.write_text(text, encoding="utf-8")
    return path


def test_columns_are_returned_in_the_requested_order(tmp_path):
    path = write(tmp_path, "Z, other ,S_m\n5,x,0\n6,,10\n")
    s, z = read_columns(path, "road", NAMES)
    assert s.tolist() == [0.0, 10.0]
    assert z.tolist() == [5.0, 6.0]
    assert read_names(path, "road") == ["z", "other", "s_m"]


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("", "columns s_m and z_m are needed"),
        ("s_m,x\n0,1\n", "found"),
        ("s_m,z_m\n0,1\n0,one\n", "not a number in row 2"),
        ("s_m,z_m\n0\n1,2\n", "not a number"),
        ("s_m,z_m\n0,1\n", "fewer than 2 rows"),
        ("s_m,z_m\n0,nan\n1,2\n", "not finite"),
        ("s_m,z_m\n0,1\n1,inf\n", "not finite, the first in row 2"),
    ],
)
def test_an_unusable_table_is_refused_with_its_file_name(tmp_path, text, words):
    with pytest.raises(InputError, match=words) as refused:
        read_columns(write(tmp_path, text), "road", NAMES)
    assert "table.csv" in str(refused.value)


@dataclass(frozen=True)
class Axle:
    name: str
    load: float
    wheels: int = 4


def test_rows_take_the_defaults_of_columns_that_a_file_lacks(tmp_path):
    rows = read_rows(write(tmp_path, "name,load\nsteer,7.1\ncut\n"), Axle, "axles")
    assert rows == [Axle("steer", 7.1, 4)]
    assert read_rows(write(tmp_path, "name,load,wheels\nsteer,7.1,2\n"), Axle, "axles") == [
        Axle("steer", 7.1, 2)
    ]
    for header in ("name,wheels", "load,name", "name,load,color"):
        with pytest.raises(InputError, match="not a file of axles: its columns differ"):
            read_rows(write(tmp_path, f"{header}\n1,1,1\n"), Axle, "axles")


def test_missing_files_and_binary_files_are_refused(tmp_path):
    path = tmp_path / "table.csv"
    with pytest.raises(InputError, match="cannot be read"):
        read_columns(path, "road", NAMES)
    path.write_bytes(b"s_m,z_m\n\xff\xfe,1\n")
    with pytest.raises(InputError, match="cannot be read"):
        read_columns(path, "road", NAMES)


def test_every_reader_accepts_byte_order_marks_comments_and_empty_rows(tmp_path):
    # Spreadsheets and editors leave these behind.
    def dirty(header, rows):
        body = "\n\n".join(",".join(f"{x:g}" for x in row) for row in rows)
        return write(tmp_path, f"\ufeff# from a test\n{header}\n\n{body}\n,\n\n")

    way = np.arange(0.0, 501.0, 50.0)
    heights = np.column_stack([way, 0.01 * way])
    road = RoadProfile.from_csv(dirty("s_m,z_m", heights))
    assert road.grade == pytest.approx(np.full(10, 0.01))
    assert route_from_csv(dirty("s_m,z_m", heights)).length == pytest.approx(500.0, rel=1e-3)
    speeds = np.column_stack([way, np.full(way.size, 20.0)])
    assert read_profile(dirty("station_m,speed_mps", speeds)).at(100.0) == 20.0
    cycle = np.column_stack([way, np.full(way.size, 20.0), np.zeros(way.size)])
    assert read_cycle(dirty("cycSecs,cycMps,cycGrade", cycle)).speed == pytest.approx(20.0)
