"""The command `iits-mj truck`."""

import json

import pytest

from iits_mj import cli
from iits_mj.parameters.schema import truck_schema


def test_check_prints_every_truck(capsys):
    assert cli.main(["truck", "check", "vecto_tractor", "vecto_40t"]) == 0
    shown = capsys.readouterr().out
    assert "mass laden" in shown
    assert "40.00 t" in shown
    assert "warning: tires.trailer is on no axle" in shown


def test_schema_is_printed_as_json(capsys):
    assert cli.main(["truck", "schema"]) == 0
    assert json.loads(capsys.readouterr().out) == truck_schema()


def test_flags_may_stand_between_the_words(tmp_path, capsys):
    page = tmp_path / "pages" / "a.html"
    assert cli.main(["truck", "show", "--out", str(page), "vecto_tractor"]) == 0
    assert "vecto_tractor" in page.read_text(encoding="utf-8")
    assert str(page) in capsys.readouterr().out


def test_comparison_goes_into_a_folder_and_onto_the_screen(tmp_path, capsys):
    assert cli.main(["truck", "compare", "vecto_tractor", "vecto_40t", "--out", str(tmp_path)]) == 0
    assert "0 to 80 km/h, full pedal" in capsys.readouterr().out
    assert (tmp_path / "truck.html").is_file()


@pytest.mark.parametrize(
    ("words", "reported"),
    [
        (("fly",), "use one of: check, show, compare, export, schema"),
        (("check",), "truck check needs 1 or more names or files, got 0"),
        (("show", "vecto_40t", "b_double"), "truck show needs 1 names or files, got 2"),
        (("compare", "vecto_40t"), "truck compare needs 2 or more"),
        (
            ("check", "nowhere"),
            "truck 'nowhere' is neither a file or folder nor one of the shipped",
        ),
        (("schema", "vecto_40t"), "needs 0 names"),
    ],
)
def test_wrong_use_is_one_line(words, reported, capsys):
    assert cli.main(["truck", *words]) == 2
    error = capsys.readouterr().err
    assert reported in error
    assert error.count("\n") == 1
