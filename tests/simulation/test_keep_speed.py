"""`examples/keep_speed.py`: its bus, its steering, and its command line."""

from __future__ import annotations

import importlib.util
import math
import subprocess
import sys
from collections.abc import Iterator
from types import ModuleType, SimpleNamespace

import can
import pytest

from iits_mj.j1939 import Frame, encode, groups
from iits_mj.j1939.bus import to_can
from iits_mj.simulation import ServeConfig, Server
from tests.paths import ROOT

EXAMPLES = ROOT / "examples"


class Clock:
    """A clock that advances only during a sleep."""

    def __init__(self) -> None:
        self.now = 0.0

    def monotonic(self) -> float:
        return self.now

    def sleep(self, seconds: float) -> None:
        self.now += seconds


class Silence:
    """A bus without other members."""

    def __init__(self) -> None:
        self.sent: list[can.Message] = []

    def send(self, message: can.Message) -> None:
        self.sent.append(message)


@pytest.fixture
def example(monkeypatch: pytest.MonkeyPatch) -> ModuleType:
    spec = importlib.util.spec_from_file_location("keep_speed", EXAMPLES / "keep_speed.py")
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    monkeypatch.setitem(sys.modules, "keep_speed", module)
    spec.loader.exec_module(module)
    return module


@pytest.fixture
def clock(example: ModuleType, monkeypatch: pytest.MonkeyPatch) -> Clock:
    clock = Clock()
    monkeypatch.setattr(example, "time", SimpleNamespace(monotonic=clock.monotonic))
    return clock


def hear(controller: object, frame: Frame, source: int | None = None) -> None:
    can_id = frame.can_id if source is None else frame.can_id & ~0xFF | source
    controller.take(to_can(Frame(can_id, frame.data, frame.time)))  # type: ignore[attr-defined]


def test_speed_that_is_not_available_is_ignored(example: ModuleType, clock: Clock) -> None:
    controller = example.Controller(Silence(), 60.0 / 3.6)
    good = encode(groups.CCVS1(wheel_based_speed_kph=59.0))
    hear(controller, good)
    assert controller.heard == {"wheel_based_speed_kph": 59.0}
    # Highest number, first of the reserved, error, not available.
    for raw, taken in ((0xFAFF, True), (0xFB00, False), (0xFE00, False), (0xFFFF, False)):
        data = bytearray(good.data)
        data[1:3] = raw.to_bytes(2, "little")
        hear(controller, good)
        hear(controller, Frame(good.can_id, bytes(data)))
        assert controller.heard["wheel_based_speed_kph"] == (raw / 256.0 if taken else 59.0)
    # The last speed is valid for half a second, then the truck counts as silent.
    hear(controller, good)
    clock.now += 0.4
    assert "CCVS1 wheel_based_speed_kph" not in controller.missing()
    hear(controller, Frame(good.can_id, bytes(data)))
    clock.now += 0.2
    assert "CCVS1 wheel_based_speed_kph" in controller.missing()


def test_speed_of_another_unit_and_of_a_short_frame_is_ignored(
    example: ModuleType, clock: Clock
) -> None:
    del clock
    controller = example.Controller(Silence(), 60.0 / 3.6)
    good = encode(groups.CCVS1(wheel_based_speed_kph=90.0))
    hear(controller, good, source=0x31)
    hear(controller, Frame(good.can_id, good.data[:2]))
    controller.take(can.Message(arbitration_id=good.can_id, is_remote_frame=True))
    assert controller.heard == {}
    hear(controller, good)
    assert controller.heard == {"wheel_based_speed_kph": 90.0}


class Served:
    """The bus of a served truck; its time advances while the controller waits for frames."""

    def __init__(self, server: Server, bus: can.BusABC) -> None:
        self.server, self.bus = server, bus
        self.send = bus.send

    def recv(self, timeout: float) -> can.Message | None:
        del timeout
        message = self.bus.recv(0.0)
        if message is None:
            self.server.tick()
        return message or self.bus.recv(0.0)


def angles(
    example: ModuleType, clock: Clock, speed: float, payload: float, duration: float
) -> Iterator[tuple[float, float, float]]:
    """Time [s], angle of the steering wheel [rad] and distance from the line [m] of a drive.

    After 5 s the line is moved by half a metre.
    """
    config = ServeConfig(
        bus="virtual", channel="keep_speed", payload=payload, start_speed=speed, start_station=300.0
    )
    with (
        Server(config, clock=clock.monotonic, sleep=clock.sleep) as server,
        can.Bus(interface="virtual", channel="keep_speed") as bus,
    ):
        controller = example.Controller(Served(server, bus), speed)
        assert example.wait_for_truck(controller, 5.0) == []
        start = clock.now
        for step in range(round(duration / 0.02)):
            if step == 250:
                controller.line += 0.5
            controller.control(step)
            controller.listen(start + (step + 1) * 0.02)
            yield step * 0.02, server.command.steering_wheel_angle, controller.line_errors[-1]


@pytest.mark.parametrize(("kmh", "payload"), [(5.0, 0.0), (13.0, 36_000.0)])
def test_a_slow_truck_reaches_its_line_with_small_steering_angles(
    example: ModuleType, clock: Clock, kmh: float, payload: float
) -> None:
    drive = list(angles(example, clock, kmh / 3.6, payload, 20.0))
    assert max(abs(angle) for _, angle, _ in drive) < 2.0
    late = [(angle, line) for time, angle, line in drive if time > 16.0]
    assert max(angle for angle, _ in late) - min(angle for angle, _ in late) < 0.4
    assert max(abs(line) for _, line in late) < 0.25


def test_low_speed_gives_pedal_and_high_speed_gives_brake(
    example: ModuleType,
) -> None:
    keeper = example.SpeedKeeper()
    assert keeper.step(5.0, 16.7, 55_000.0, 0.02) == (keeper.FULL, 0.0)
    # Ten minutes on a hill that is too steep cause no wind-up.
    for _ in range(30_000):
        keeper.step(5.0, 11.7, 55_000.0, 0.02)
    pedal, demand = keeper.step(-1.0, 17.7, 55_000.0, 0.02)
    assert pedal == 0.0
    assert -1.5 < demand < -0.5
    assert math.isclose(keeper.step(-50.0, 66.7, 55_000.0, 0.02)[1], -3.0)


@pytest.mark.parametrize("example_name", ["keep_speed.py", "stack_over_bus.py"])
@pytest.mark.parametrize(
    ("words", "reported"),
    [
        (["--speed", "nan", "--duration", "-1"], "5 to 90"),
        (["--channel", "10.0.0.1"], "10.0.0.1"),
    ],
)
def test_wrong_use_of_an_example_is_one_line_without_a_wait(
    example_name: str, words: list[str], reported: str
) -> None:
    done = subprocess.run(
        [sys.executable, str(EXAMPLES / example_name), *words],
        text=True,
        capture_output=True,
        timeout=30,
        cwd=EXAMPLES.parent,
    )
    assert done.returncode == 2
    assert done.stdout == ""
    assert len(done.stderr.splitlines()) == 1, done.stderr
    assert reported in done.stderr
