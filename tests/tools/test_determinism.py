"""The short form of `make determinism`."""

import determinism
import pytest

pytest.importorskip("libsumo")


@pytest.mark.parametrize("group", ["physics", "bus"])
def test_every_way_to_run_gives_the_same_digest(group):
    digests = determinism.compare([group], short=True)[group]
    assert len(digests) >= 3
    assert len(set(digests.values())) == 1, digests


@pytest.mark.slow
@pytest.mark.parametrize("group", determinism.GROUPS)
def test_every_way_to_run_gives_the_same_digest_in_long_runs(group):
    assert len(set(determinism.compare([group], short=False)[group].values())) <= 1


def test_a_way_that_differs_is_reported(monkeypatch, capsys):
    ways = [determinism.Way(name, lambda d=name: d) for name in ("one", "two")]
    monkeypatch.setattr(determinism, "ways", lambda group, short: ways)
    monkeypatch.setattr("sys.argv", ["determinism", "--only", "trips"])
    assert determinism.main() == 1
    shown = capsys.readouterr().out
    assert "DIFFERENT" in shown
    assert "different: trips" in shown
