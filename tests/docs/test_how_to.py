"""The examples of the how-to pages: equal to the files that they name, short, and working."""

from __future__ import annotations

import re
import subprocess
import sys
from pathlib import Path
from typing import Any

import gymnasium
import pytest

from iits_mj.parameters import TruckParameters
from iits_mj.render.cameras import make_camera
from iits_mj.simulation import DriveConfig, Simulation
from tests.paths import ROOT

FOLDER, EXAMPLES = ROOT / "docs" / "how_to", ROOT / "examples"
PAGES = sorted(FOLDER.glob("*.md"))
# Parts of the pages, by page, option and name.
PARTS = [
    ("own_decision.md", "decision", "Impatient"),
    ("own_planner.md", "planner", "RightLane"),
    ("own_planner.md", "planner", "Careful"),
    ("own_controller.md", "lateral", "Stanley"),
    ("own_controller.md", "lateral", "softer"),
    ("own_controller.md", "longitudinal", "Proportional"),
    ("own_speed.md", "speed_planner", "Hills"),
    ("own_traffic.md", "traffic_mode", "Wave"),
]


def blocks(page: str, language: str = "python") -> list[str]:
    text = (FOLDER / page).read_text(encoding="utf-8")
    return re.findall(rf"```{language}\n(.*?)```", text, re.DOTALL)


def names_of(page: str) -> dict[str, Any]:
    names: dict[str, Any] = {"__name__": page}
    for block in blocks(page):
        exec(compile(block, page, "exec"), names)
    return names


def test_every_example_is_a_file_of_fewer_than_30_lines_that_a_page_shows_unchanged() -> None:
    shown = {}
    for page in PAGES:
        text = page.read_text(encoding="utf-8")
        for name, code in re.findall(r"`examples/([\w/.]+)`[^`]*\n\n```\w+\n(.*?)```", text, re.S):
            shown[name] = code
    files = [
        *EXAMPLES.glob("own_*.py"),
        EXAMPLES / "cut_in.toml",
        *(EXAMPLES / "stronger_engine").iterdir(),
    ]
    assert shown == {str(f.relative_to(EXAMPLES)): f.read_text(encoding="utf-8") for f in files}
    assert max(code.count("\n") for code in shown.values()) < 30


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_incomplete_examples_are_valid_python(page: Path) -> None:
    for block in blocks(page.name, "py"):
        compile(block, page.name, "exec")


@pytest.mark.parametrize(("page", "option", "name"), PARTS)
def test_the_part_of_the_page_drives(page: str, option: str, name: str) -> None:
    options: dict[str, Any] = {"traffic_mode": "none", "decision": "keep", "duration": 3.0}
    options |= {"speed_planner": "cruise", option: names_of(page)[name]}
    with Simulation(DriveConfig(**options), visuals=False) as drive:
        summary = drive.run()
        assert not summary.failed
        assert 40.0 < summary.distance < 55.0
        assert abs(drive.frame.ego.offset - drive.route.lane_offset(0, 100.0)) < 0.2


def test_the_decision_maker_of_the_page_passes_a_slow_leader(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.chdir(ROOT)
    config = DriveConfig(
        decision="examples/own_decision.py:Impatient",
        traffic_mode="examples/own_traffic.py:Wave:speed=10:swing=1",
        speed_planner="cruise",
        duration=14.0,
    )
    with Simulation(config, visuals=False) as drive:
        assert drive.run().lane_changes == 1


def test_the_car_of_the_page_cuts_in_15_m_before_the_truck() -> None:
    config = DriveConfig(
        events=EXAMPLES / "cut_in.toml",
        traffic_mode="none",
        start_station=300.0,
        plant="yaw-sideslip",
        duration=40.0,
    )
    with Simulation(config, visuals=False) as drive:
        aside = None
        while not any(record.event.kind == "brake" for record in drive.events):
            frame = drive.cycle()
            (car,) = drive.vehicles
            if aside is None and car.lateral_speed < 0.0:
                front = frame.ego.station + drive.truck.footprint.front_overhang
                aside = car.station - 0.5 * car.length - front, car.speed - frame.ego.speed
        assert aside == (pytest.approx(15.0, abs=0.4), pytest.approx(-2.0, abs=0.2))
        assert car.lane == 0


def test_the_cameras_of_the_page_look_at_the_truck() -> None:
    names = names_of("own_camera.md")
    config = DriveConfig(traffic_mode="none", speed_planner="cruise", decision="keep")
    with Simulation(config, visuals=False) as drive:
        data = drive.truck.data
        for name in ("Orbit", "low"):
            seen = make_camera(names[name], truck=drive.truck.parameters).follow(data, 60.0)
            away = seen.lookat[:2] - data.body("tractor").xpos[:2]
            assert float(abs(away).max()) < 5.0


def test_the_wrapper_of_the_page_charges_the_fuel() -> None:
    names: dict[str, Any] = {}
    exec(blocks("own_reward.md")[0], names)
    wrapper = names["FuelPrice"]
    plain = gymnasium.make("iits_mj:iits_mj/LaneKeep-v0")
    priced = wrapper(gymnasium.make("iits_mj:iits_mj/LaneKeep-v0"), price=10.0)
    _, before = plain.reset(seed=1)
    priced.reset(seed=1)
    action = plain.action_space.high
    _, reward, _, _, info = plain.step(action)
    _, less, _, _, _ = priced.step(action)
    burnt = info["fuel_used"] - before["fuel_used"]
    assert burnt > 0.0
    assert less == pytest.approx(float(reward) - 10.0 * burnt)


def test_the_task_of_the_page_works_with_both_interfaces() -> None:
    # In its own process: the task stays in the suite.
    code = """
import own_task
from iits_mj import suite
from iits_mj.envs.driving import DrivingEnv
environment = suite.load("truck", "straight_lane_keep")
environment.reset()
assert 0.0 <= environment.step([0.0, 0.0]).reward <= 1.0
with DrivingEnv("straight_lane_keep") as other:
    other.reset(seed=1)
    assert "reward_straight" in other.step([0.0, 0.0])[4]
try:
    suite.register("straight_lane_keep", own_task.StraightLaneKeep)
except ValueError as error:
    print(error)
"""
    done = subprocess.run(
        [sys.executable, "-c", code], cwd=EXAMPLES, capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stderr
    assert "is there already" in done.stdout


def test_the_engine_of_the_page_is_a_tenth_stronger() -> None:
    shipped, stronger = TruckParameters.load(), TruckParameters.load(EXAMPLES / "stronger_engine")
    assert stronger.engine.full_load_power == pytest.approx(
        1.1 * shipped.engine.full_load_power, rel=1e-3
    )
    assert stronger.gross_mass(0.0) == shipped.gross_mass(0.0)
