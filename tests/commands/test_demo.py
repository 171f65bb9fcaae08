"""The demo, which is `iits-mj drive` without options of the drive itself."""

from __future__ import annotations

import dataclasses
from typing import Any

import pytest

from iits_mj import cli
from iits_mj.commands import arguments, drive
from iits_mj.simulation import DriveConfig, Observer, Simulation


class Shown(Observer):
    """Keeps what a viewer of the demo would see."""

    period = 0.5

    def __init__(self) -> None:
        self.lanes: list[int] = []
        self.in_tunnel: list[bool] = []
        self.retarder: list[float] = []
        self.near: list[int] = []
        self.ahead: set[str] = set()
        self.passed: set[str] = set()

    def observe(self, simulation: Any, frame: Any) -> None:
        ego, length = frame.ego, simulation.truck.parameters.length
        (start, end), *_ = simulation.route.tunnels
        self.lanes.append(frame.lane)
        self.in_tunnel.append(start < ego.station < end)
        fast_fall = frame.grade < -0.02 and ego.speed > 13.0
        self.retarder.append((simulation.truck.report().retarder_torque or 0.0) * fast_fall)
        gaps = {v.id: v.station - ego.station for v in frame.scene.vehicles}
        self.near.append(sum(-20.0 < gap < 150.0 for gap in gaps.values()))
        self.ahead |= {name for name, gap in gaps.items() if gap > 0.0}
        self.passed |= {name for name in self.ahead & set(gaps) if gaps[name] < -length}


def test_demo_leaves_the_tunnel_overtakes_returns_and_descends_on_the_retarder() -> None:
    shown = Shown()
    config = DriveConfig(**drive.DEMO)
    with Simulation(config, visuals=False) as simulation:
        summary = simulation.run([shown])
    assert summary.ended == "reached the end of the time"
    assert summary.duration == pytest.approx(60.0)
    changes = "".join(str(lane) for lane in shown.lanes)
    left = changes.index("01")
    back = changes.index("10", left)
    assert back < 70
    assert changes[back + 1 :].count("1") == 0
    assert len(shown.passed) >= 2
    assert 0.15 < sum(shown.in_tunnel) / len(shown.in_tunnel) < 0.35
    assert not any(shown.in_tunnel[40:])
    assert sum(torque > 1000.0 for torque in shown.retarder) >= 20
    assert sum(count > 0 for count in shown.near) / len(shown.near) > 0.9


def demo_of(*words: str) -> bool:
    options = arguments.parse(drive.Options, words, "iits-mj drive", "")
    return drive._is_default(options)


def test_any_option_of_the_drive_replaces_the_demo() -> None:
    assert demo_of()
    assert demo_of("--camera", "chase,top", "--weather", "night", "--no-video", "--out", "there")
    for name, value in (("duration", "120"), ("seed", "0"), ("map", "road.xodr")):
        assert not demo_of(f"--{name}", value)
    assert not drive._is_default(dataclasses.replace(drive.Options(), speed=20.0))


def test_demo_names_its_options(
    tmp_path: Any, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(drive, "DEMO", {**drive.DEMO, "duration": 1.0})
    assert cli.main(["drive", "--no-video", "--out", str(tmp_path)]) == 0
    error = capsys.readouterr().err
    assert "demo drive" in error
    assert "--seed 4 --duration 1.0 --density medium" in error
