import dataclasses
import json
import threading
import time

import pytest

from iits_mj.core.errors import Error
from iits_mj.simulation import DriveConfig
from iits_mj.web import WebServer
from iits_mj.web.live import LiveDrive, NewDrive
from iits_mj.web.manual import Hands
from iits_mj.web.stage import Stage

pytest.importorskip("mjviser")

CONFIG = DriveConfig(duration=1000.0, density="sparse", speed_planner="cruise")


class Told(WebServer):
    """A server that keeps what it tells."""

    def __init__(self):
        super().__init__(port=0, title="a test")
        self.told = []

    def tell(self, kind, content):
        # Numbers that are not finite are no JSON.
        json.dumps(content, allow_nan=False)
        self.told.append((kind, content))
        super().tell(kind, content)

    def last(self):
        return next(content for kind, content in reversed(self.told) if kind == "state")


@pytest.fixture(scope="module")
def live():
    """A drive in a thread of its own, ended by an interrupt between two cycles."""
    with Told() as server, LiveDrive(server, CONFIG, pace=8.0) as drive:
        drive._handlers["end"] = _interrupt
        thread = threading.Thread(target=drive.run)
        thread.start()
        yield drive
        drive.requests.put("end")
        thread.join(60.0)
        assert not thread.is_alive()


def _interrupt(value):
    raise KeyboardInterrupt


def until(condition):
    end = time.monotonic() + 60.0
    while not condition():
        assert time.monotonic() < end
        time.sleep(0.01)


@pytest.fixture
def running(live):
    live.looks.put("pause", False)
    until(lambda: not live.paused)
    return live


def test_a_pause_holds_the_time_and_a_step_advances_by_a_tenth(running):
    until(lambda: running.now > 0.3)
    running.looks.put("pause", True)
    until(lambda: running.paused)
    held = running.now
    time.sleep(0.3)
    assert running.now == held
    running.looks.put("step")
    until(lambda: running.now > held)
    until(lambda: running.paused)
    assert running.now == pytest.approx(held + 0.1, abs=0.03)
    until(lambda: running.server.last()["paused"])


def test_the_instruments_have_units_and_no_missing_values(running):
    state = running.state()
    assert {"speed", "gear", "engine", "pedal", "brake", "retarder", "rows", "choice"} <= set(state)
    text = str(state).lower()
    assert not any(word in text for word in ("none", "nan", "inf"))
    assert [name for name, *_ in state["choice"]] == ["left", "keep", "right"]
    assert sum(taken for *_, taken in state["choice"]) == 1


def test_the_set_speed_changes_while_driving(running):
    running.requests.put("speed", 12.0)
    until(lambda: running.config.speed == 12.0)
    until(lambda: running.simulation.frame.reference_speed == 12.0)


def test_an_impossible_event_is_told(running):
    running.requests.put("event", "Snow")
    until(lambda: "Snow" in running.server.last()["message"])
    assert running.server.last()["level"] == "warning"


def test_one_page_has_the_wheel_until_it_is_closed(running):
    running.message(7, {"take": True})
    until(lambda: running.driver.driving)
    running.message(8, {"take": True})
    running.message(8, {"hands": {"steer": 1.0}})
    running.message(7, {"hands": {"steer": -1.0}})
    assert running.given[0].steer == -1.0
    until(lambda: running.simulation.frame.ego.steering_wheel_angle < -0.02)
    assert running.inputs
    running.left(8)
    assert running.holder == 7
    running.left(7)
    until(lambda: not running.driver.driving)


def test_a_driver_whose_page_is_silent_is_relieved(running):
    running.message(7, {"take": True})
    until(lambda: running.driver.driving)
    until(lambda: not running.driver.driving)
    assert running.holder == 0


def test_a_new_drive_has_another_seed_load_and_friction(running):
    wanted = NewDrive(seed=5, payload=10_000.0, density="dense", friction=0.4)
    running.requests.put("drive", wanted)
    until(lambda: running.config.seed == 5 and not running.simulation.ended)
    until(lambda: running.now > 0.0)
    simulation = running.simulation
    assert simulation.truck.payload == 10_000.0
    assert simulation.route.friction(100.0, 0.0) == 0.4
    assert simulation.config.density == "dense"


def test_an_impossible_drive_is_told_and_another_one_can_be_started(running):
    before = running.config
    running.requests.put("drive", dataclasses.replace(NEXT, payload=1e9))
    until(lambda: "payload" in running.server.last()["message"])
    assert running.config == before
    running.requests.put("drive", NEXT)
    until(lambda: running.now > 0.1)


NEXT = NewDrive(seed=1, payload=20_000.0, density="sparse", friction=None)


def test_without_a_page_the_drive_goes_on(running):
    assert not running.server.watched
    start = running.now
    until(lambda: running.now > start + 1.0)


class Failing(Stage):
    now = 0.0

    def play(self):
        raise Error("the simulation diverged at t = 1.00 s")


def test_an_error_is_shown_in_the_browser_and_raised():
    with Told() as server, pytest.raises(Error, match="diverged"):
        Failing(server).run()
    assert server.told[-1] == ("error", "the simulation diverged at t = 1.00 s")


def test_a_stale_input_brakes_gently(live):
    live.given = Hands(pedal=1.0), time.monotonic() - 1.0
    assert live.hands(0.0) == Hands(brake=0.3)
