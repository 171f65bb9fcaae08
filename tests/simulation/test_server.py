"""The served truck reports at its rates, obeys the bus, and is safe without it."""

from __future__ import annotations

import dataclasses
import json
import uuid
from collections import Counter
from collections.abc import Callable, Iterator
from pathlib import Path

import can
import pytest
from can.interfaces.virtual import VirtualBus

from iits_mj import cli
from iits_mj.core.errors import BusError, InputError
from iits_mj.core.messages import TransmissionMode, VehicleCommand, XbrMode
from iits_mj.j1939 import (
    Bus,
    Frame,
    LinkState,
    Reassembler,
    StateReceiver,
    command_to_frames,
    cycle_time,
    decode,
    pgn_of,
    read_log,
)
from iits_mj.j1939.frame import GLOBAL_ADDRESS, make_id
from iits_mj.j1939.network import ADDRESS_CLAIMED, BRAKES, request
from iits_mj.j1939.receiver import UNIT_NAMES
from iits_mj.simulation import ServeConfig, Server
from iits_mj.simulation.frame import LEAVE_MARGIN, ROLL_OVER
from iits_mj.simulation.server import TICK
from iits_mj.truck import Truck

KEEP = VehicleCommand(accelerator_pedal=0.4)


class Clock:
    """A clock that advances only during a sleep: a served second takes no real second."""

    def __init__(self) -> None:
        self.now = 0.0

    def __call__(self) -> float:
        return self.now

    def sleep(self, seconds: float) -> None:
        self.now += seconds


class Plug(VirtualBus):
    """A virtual bus that can be unplugged or bus-off."""

    pulled = False
    off = False

    def __init__(self, *args: object, **kwargs: object) -> None:
        if Plug.pulled:
            raise can.CanInitializationError("no such device")
        super().__init__(*args, **kwargs)  # type: ignore[arg-type]

    def _check_if_open(self) -> None:
        if Plug.pulled:
            raise can.CanOperationError("network is down")
        super()._check_if_open()

    @property
    def state(self) -> can.BusState:
        return can.BusState.ERROR if Plug.off else can.BusState.ACTIVE


@pytest.fixture
def plug(monkeypatch: pytest.MonkeyPatch) -> None:
    """Makes every virtual bus a `Plug` that works."""
    monkeypatch.setitem(can.interfaces.BACKENDS, "virtual", (__name__, "Plug"))
    monkeypatch.setattr(Plug, "pulled", False)
    monkeypatch.setattr(Plug, "off", False)


class Bench:
    """A server and a controller's bus in one process with one clock."""

    def __init__(self, **settings: object) -> None:
        self.clock = Clock()
        self.reported: list[str] = []
        config = ServeConfig(
            bus="virtual", channel=uuid.uuid4().hex, **{"start_speed": 16.0, **settings}
        )
        self.server = Server(
            config, tell=self.reported.append, clock=self.clock, sleep=self.clock.sleep
        )
        self.bus = Bus("virtual", config.channel)
        self.heard: list[Frame] = []
        self.counter = 0

    def serve(self, seconds: float, command: VehicleCommand | None = None) -> None:
        """Serves for a time, with a command every 20 ms, if any."""
        for i in range(round(seconds / TICK)):
            if command is not None and i % 2 == 0:
                self.send(command)
            self.server.tick()
            self.heard += self.bus.receive()

    def send(self, command: VehicleCommand) -> None:
        for frame in command_to_frames(command, self.counter, self.server.time):
            self.bus.send(frame)
        self.counter += 1

    def close(self) -> None:
        self.bus.close()
        self.server.close()


@pytest.fixture
def bench() -> Iterator[Callable[..., Bench]]:
    made: list[Bench] = []

    def make(**settings: object) -> Bench:
        made.append(Bench(**settings))
        return made[-1]

    yield make
    for one in made:
        one.close()


def test_every_report_is_sent_at_its_rate(bench: Callable[..., Bench]) -> None:
    here = bench()
    here.serve(2.01)
    groups = [found for frame in here.heard if (found := decode(frame)) is not None]
    counts = Counter((group.name, group.source) for group in groups)
    assert len(counts) > 20
    for (name, source), count in counts.items():
        axles = 6 if name == "VW" else 1
        assert count / axles == pytest.approx(2.0 / cycle_time(name), abs=1.01), (name, source)
    stamps = sorted({frame.time for frame in here.heard})
    assert stamps == pytest.approx([TICK * tick for tick in range(201)], abs=1e-9)


def test_addresses_are_claimed_before_anything_else(bench: Callable[..., Bench]) -> None:
    here = bench()
    here.serve(1.2)
    claims = [i for i, frame in enumerate(here.heard) if frame.pgn == ADDRESS_CLAIMED]
    claimed = {here.heard[i].source for i in claims}
    assert claims == list(range(len(claims)))
    assert claimed == {frame.source for frame in here.heard}


def test_requests_are_answered_over_the_bus(bench: Callable[..., Bench]) -> None:
    here = bench()
    here.serve(0.5)
    here.heard.clear()
    here.bus.send(request(pgn_of("HRLFC"), 0xF9))
    here.bus.send(request(pgn_of("HRLFC"), 0xF9, 3))
    here.serve(TICK)
    assert pgn_of("HRLFC") in [frame.pgn for frame in here.heard]
    assert [f.data[4] for f in here.heard if f.pgn == 0xE800 and f.source == 3] == [0xF9]
    assert here.server.summary().requests == {"answered": 1, "refused": 1}


def test_long_message_is_broadcast_again_on_request(bench: Callable[..., Bench]) -> None:
    here = bench()
    here.serve(1.0)
    found = []
    for asked in (False, True):
        here.heard.clear()
        if asked:
            here.bus.send(request(pgn_of("EC1"), 0xF9, 0))
        here.serve(1.0)
        reassembler = Reassembler()
        found.append([m for f in here.heard if (m := reassembler.receive(f)) is not None])
    assert found[0] == []
    assert [(message.pgn, message.source) for message in found[1]] == [(pgn_of("EC1"), 0)]


def test_truck_obeys_the_bus_and_reports_its_motion(bench: Callable[..., Bench]) -> None:
    here = bench(payload=0.0)
    here.serve(4.0, VehicleCommand(accelerator_pedal=0.9, steering_wheel_angle=0.1))
    truth = here.server.state
    assert truth.speed > 16.5
    assert truth.steering_wheel_angle == pytest.approx(0.1, abs=0.01)
    watcher = StateReceiver()
    for frame in here.heard:
        watcher.receive(frame)
    assert watcher.state().speed == pytest.approx(truth.speed, abs=0.05)
    assert watcher.state().station == pytest.approx(truth.station, abs=0.5)
    assert here.server.summary().accepted["XBR"] == 200


def test_only_the_selected_sender_is_obeyed(bench: Callable[..., Bench]) -> None:
    here = bench(source=0x21)
    here.serve(0.5, KEEP)
    assert here.server.command.accelerator_pedal == 0.0
    assert here.server.summary().passed_over["XBR: from an address that is not obeyed"] == 25
    named = bench(source=0x2A)
    named.serve(0.5, KEEP)
    assert named.server.command.accelerator_pedal == pytest.approx(0.4)


def test_xbr_of_a_second_sender_is_not_obeyed_and_is_reported_once(
    bench: Callable[..., Bench],
) -> None:
    here = bench()
    brake = VehicleCommand(xbr_demand=-6.0, xbr_mode=XbrMode.MAXIMUM)
    for counter in range(50):
        for frame in command_to_frames(brake, counter, here.server.time, source=0x31):
            here.bus.send(frame)
        here.serve(0.02, KEEP)
    assert here.server.command.xbr_mode is XbrMode.OFF
    assert here.server.state.speed > 15.5
    summary = here.server.summary()
    assert summary.passed_over["XBR: from an address that is not obeyed"] == 50
    lines = [line for line in here.reported if line.startswith("XBR")]
    assert len(lines) == 1
    assert "XBR from address 0x31 is not obeyed" in lines[0]
    assert "the sender to obey is 0x2A; --source selects another" in lines[0]
    opened = bench(any_source=True)
    for counter in range(50):
        for frame in command_to_frames(brake, counter, opened.server.time, source=0x31):
            opened.bus.send(frame)
        opened.serve(0.02, KEEP)
    assert opened.server.state.speed < 14.0


def test_truck_that_loses_an_address_stops_in_its_lane_and_names_it(
    bench: Callable[..., Bench],
) -> None:
    here = bench()
    here.serve(0.5, KEEP)
    # A NAME of zero wins every address.
    here.bus.send(Frame(make_id(6, ADDRESS_CLAIMED, BRAKES, GLOBAL_ADDRESS), bytes(8), 0.0))
    here.serve(14.0, KEEP)
    assert abs(here.server.state.speed) < 0.1
    assert abs(here.server.state.offset - here.server.route.lane_offset(0, 20.0)) < 0.5
    assert not here.server.ended
    assert here.server.summary().lost_addresses == [BRAKES]
    lines = [line for line in here.reported if "address 0x0B is claimed by another node" in line]
    assert len(lines) == 1


def test_truck_stays_parked_until_the_first_command(bench: Callable[..., Bench]) -> None:
    here = bench(start_speed=0.0, start_station=600.0)
    here.serve(3.0)
    assert here.server.command.parking_brake == 1.0
    assert abs(here.server.state.station - 600.0) < 0.1
    here.serve(0.1, VehicleCommand())
    assert here.server.command.parking_brake == 0.0
    assert here.server.summary().silences == 0


def test_silent_bus_releases_pedal_and_brakes_and_holds_the_wheel(
    bench: Callable[..., Bench],
) -> None:
    here = bench(on_silence="release")
    here.serve(1.0, dataclasses.replace(KEEP, steering_wheel_angle=0.05))
    assert here.server.command.accelerator_pedal == pytest.approx(0.4)
    here.serve(0.3)
    assert here.server.silent
    assert here.server.command.accelerator_pedal == 0.0
    assert here.server.command.steering_wheel_angle == pytest.approx(0.05, abs=5e-4)
    here.serve(0.1, KEEP)
    assert here.server.command.accelerator_pedal == pytest.approx(0.4)
    summary = here.server.summary()
    assert summary.silences == 1
    assert 0.15 < summary.silent_time < 0.35
    assert [line.split(" at t")[0].split(" from t")[0] for line in here.reported] == [
        "commands obeyed",
        "commands lost",
        "commands obeyed",
    ]


def test_silent_bus_stops_the_truck_in_its_lane_when_so_configured(
    bench: Callable[..., Bench],
) -> None:
    here = bench(on_silence="stop", payload=0.0, start_speed=8.0)
    here.serve(1.0, KEEP)
    here.serve(14.0)
    state = here.server.state
    assert abs(state.speed) < 0.02
    assert abs(state.offset) < 0.1
    assert here.server.command.parking_brake == 1.0
    here.serve(4.0, dataclasses.replace(KEEP, accelerator_pedal=0.6))
    assert here.server.command.parking_brake == 0.0
    assert here.server.state.speed > 0.5


@pytest.mark.usefixtures("plug")
def test_truck_obeys_again_after_the_bus_was_unplugged(
    bench: Callable[..., Bench],
) -> None:
    here = bench(on_silence="release")
    here.serve(0.5, KEEP)
    Plug.pulled = True
    for _ in range(100):
        here.server.tick()
    assert here.server.bus.link.state is LinkState.DOWN
    assert here.server.command.accelerator_pedal == 0.0
    assert here.server.time == pytest.approx(1.5)
    Plug.pulled = False
    here.serve(1.5)
    here.heard.clear()
    here.serve(1.5, KEEP)
    assert here.server.command.accelerator_pedal == pytest.approx(0.4)
    assert "EEC1" in {group.name for f in here.heard if (group := decode(f)) is not None}
    summary = here.server.summary()
    assert (summary.bus_failures, summary.bus_restarts, summary.bus_state) == (1, 1, "up")
    assert summary.dropped > 100
    assert sum("will be reopened" in line for line in here.reported) == 1


@pytest.mark.usefixtures("plug")
def test_addresses_are_claimed_again_on_a_bus_that_returns(
    bench: Callable[..., Bench],
) -> None:
    here = bench()
    here.serve(0.1)
    Plug.pulled = True
    for _ in range(10):
        here.server.tick()
    Plug.pulled = False
    here.heard.clear()
    here.serve(1.0)
    assert ADDRESS_CLAIMED in {frame.pgn for frame in here.heard}


@pytest.mark.usefixtures("plug")
def test_recovery_from_bus_off_is_reported(
    bench: Callable[..., Bench],
) -> None:
    here = bench()
    here.serve(0.1)
    Plug.off = True
    here.server.tick()
    Plug.off = False
    here.serve(0.1)
    name = here.server.bus.link.name
    assert here.server.bus.link.restarts == 0
    assert here.reported == [
        f"CAN bus {name} is bus-off, will be reopened",
        f"CAN bus {name} is up again",
    ]


@pytest.mark.usefixtures("plug")
def test_every_change_of_the_bus_within_a_tick_is_reported(bench: Callable[..., Bench]) -> None:
    here = bench()
    here.serve(0.1)
    Plug.off = True
    here.server.tick()
    first = len(here.reported)
    # Reopened while still off: up and bus-off occur in one tick.
    for _ in range(12):
        here.server.tick()
    assert [line.split(" is ")[1] for line in here.reported[first:]] == [
        "up again",
        "bus-off, will be reopened",
    ]


def test_missing_frames_are_counted(bench: Callable[..., Bench]) -> None:
    here = bench()
    here.serve(0.2, KEEP)
    here.counter += 3
    here.serve(0.2, KEEP)
    summary = here.server.summary()
    assert (summary.lost["XBR"], summary.lost["IITS_COMMAND"]) == (3, 3)
    assert "3 x XBR" in dict(summary.rows())["commands missing"]
    assert summary.as_dict()["lost"] == summary.lost


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="this system has no full device")
@pytest.mark.parametrize("suffix", [".asc", ".blf", ".log"])
def test_full_disk_ends_the_log_but_not_the_serving(
    bench: Callable[..., Bench], tmp_path: Path, suffix: str
) -> None:
    path = tmp_path / f"bus{suffix}"
    path.symlink_to("/dev/full")
    here = bench(can_log=path, duration=2.0)
    summary = here.server.run()
    assert (summary.ended, summary.failed) == ("reached the end of the time", False)
    assert summary.duration == pytest.approx(2.0)
    assert len(here.reported) == 1
    assert here.reported[0].startswith("the log ends at t = ")
    assert "No space left on device" in summary.log_failure
    assert "No space left on device" in dict(summary.rows())["log"]
    here.server.close()


def test_log_has_both_directions_of_the_bus(bench: Callable[..., Bench], tmp_path: Path) -> None:
    path = tmp_path / "bus.asc"
    here = bench(can_log=path)
    here.serve(0.5, KEEP)
    here.server.close()
    logged = list(read_log(path))
    names = {group.name for frame in logged if (group := decode(frame)) is not None}
    assert {"XBR", "IITS_COMMAND", "EEC1", "IITS_ROUTE"} <= names
    assert [f.time for f in logged] == sorted(f.time for f in logged)
    assert len(logged) == len(here.heard) + here.server.summary().received


def test_same_frames_give_the_same_drive_bit_for_bit(bench: Callable[..., Bench]) -> None:
    states = []
    for _ in range(2):
        here = bench()
        here.serve(2.0, KEEP)
        here.serve(0.5)
        here.serve(1.0, dataclasses.replace(KEEP, steering_wheel_angle=0.2))
        states.append(here.server.state)
    assert states[0] == states[1]


def test_late_ticks_are_served(bench: Callable[..., Bench]) -> None:
    here = bench()
    here.serve(0.5, KEEP)
    here.clock.now += 0.03
    here.serve(0.5, KEEP)
    here.clock.now += 2.0
    here.serve(0.5, KEEP)
    summary = here.server.summary()
    assert summary.duration == pytest.approx(1.5)
    assert summary.ticks == 150
    assert summary.late_ticks >= 3
    assert (summary.slips, summary.slipped) == (1, pytest.approx(2.0, abs=0.02))


def test_serving_ends_with_its_time_on_request_and_at_the_end_of_the_road(
    bench: Callable[..., Bench],
) -> None:
    timed = bench(duration=0.5)
    assert timed.server.run().ended == "reached the end of the time"
    assert timed.server.time == pytest.approx(0.5)
    reported = bench()
    reported.server.stop("enough")
    assert reported.server.run().ended == "enough"
    end = reported.server.route.length
    near = bench(start_station=end - 25.0, start_speed=20.0, duration=20.0)
    assert near.server.run().ended == "reached the end of the route"


@pytest.mark.parametrize(
    ("settings", "reported"),
    [
        ({"bus": "carrier_pigeon"}, "bus 'carrier_pigeon' is not known"),
        ({"start_station": 1e6}, "is not on the route"),
        ({"start_lane": 9}, "start-lane 9 does not exist"),
        ({"on_silence": "sing"}, "use one of: release, stop"),
        ({"duration": float("nan")}, "not a finite number"),
    ],
)
def test_unusable_settings_are_one_clear_error(settings: dict[str, object], reported: str) -> None:
    with pytest.raises(InputError, match=reported):
        Server(ServeConfig(**{"bus": "virtual", **settings}))


def test_unusable_log_or_bus_is_one_clear_error(tmp_path: Path) -> None:
    with pytest.raises(BusError, match="suffix"):
        Server(ServeConfig(bus="virtual", can_log=tmp_path / "log.docx"))
    with pytest.raises(BusError, match="cannot be opened"):
        Server(ServeConfig(bus="udp_multicast", channel="not an address"))


@pytest.mark.parametrize("angle", [15.0, -15.0])
def test_truck_that_rolls_over_ends_the_serving_as_failed(
    bench: Callable[..., Bench], angle: float
) -> None:
    here = bench(start_speed=25.0, start_station=950.0)
    while not here.server.ended and here.server.time < 4.0:
        here.serve(0.02, VehicleCommand(steering_wheel_angle=angle))
    summary = here.server.run()
    assert summary.ended.startswith("rolled over at t = ")
    assert summary.failed
    assert ROLL_OVER < abs(here.server.state.roll) < ROLL_OVER + 0.1
    assert 1.0 < summary.duration < 2.5


def test_a_planar_plant_reports_once_that_it_left_its_range(bench: Callable[..., Bench]) -> None:
    limit = "a wheel has lifted off the road"
    here = bench(start_station=950.0, start_speed=22.0, plant="yaw-sideslip")
    here.serve(0.5, KEEP)
    assert here.server.summary().left_range == ()
    here.serve(3.0, VehicleCommand(steering_wheel_angle=3.0))
    (told,) = [text for text in here.reported if limit in text]
    assert told.startswith("the plant yaw-sideslip is not valid from t = ")
    summary = here.server.summary()
    assert limit in summary.left_range
    assert limit in summary.to_text()


def test_a_sharp_bend_at_low_speed_does_not_end_the_serving(bench: Callable[..., Bench]) -> None:
    here = bench(start_speed=5.0, start_station=950.0)
    here.serve(2.0, VehicleCommand(steering_wheel_angle=8.0))
    assert not here.server.ended
    assert abs(here.server.state.roll) < 0.2


def test_simulation_that_diverges_ends_with_its_summary(bench: Callable[..., Bench]) -> None:
    here = bench()
    here.serve(0.5, KEEP)
    before = here.server.state
    here.server.truck.data.qvel[0] = float("nan")
    summary = here.server.run()
    assert summary.ended.startswith("the simulation diverged")
    assert summary.failed
    assert summary.duration == pytest.approx(0.5)
    assert here.server.state == before
    assert summary.as_dict()["last_speed_mps"] == pytest.approx(16.0, abs=0.5)


def test_truck_that_backs_off_the_start_of_the_road_ends_the_serving(
    bench: Callable[..., Bench],
) -> None:
    here = bench(start_speed=0.0, start_station=20.0, payload=0.0)
    back = VehicleCommand(accelerator_pedal=0.5, transmission_mode=TransmissionMode.REVERSE)
    while not here.server.ended and here.server.time < 30.0:
        here.serve(0.02, back)
    assert here.server.ended.startswith("left the road at t = ")
    assert here.server.ended.endswith("5 m before its begin")
    assert here.server.failed
    footprint = here.server.truck.footprint
    rear = here.server.state.station + footprint.front_overhang - footprint.length
    assert rear == pytest.approx(-LEAVE_MARGIN, abs=0.1)


@pytest.mark.parametrize(("angle", "side"), [(0.8, "left"), (-0.8, "right")])
def test_truck_that_leaves_the_road_sideways_ends_the_serving(
    bench: Callable[..., Bench], angle: float, side: str
) -> None:
    here = bench(payload=0.0, start_station=950.0)
    while not here.server.ended and here.server.time < 20.0:
        here.serve(0.02, VehicleCommand(steering_wheel_angle=angle))
    assert here.server.ended.endswith(f"5 m to the {side} of it")
    assert here.server.failed
    state = here.server.state
    right, left = here.server.route.surface_edges(state.station)
    outside = state.offset - left if side == "left" else right - state.offset
    assert outside == pytest.approx(LEAVE_MARGIN, abs=0.1)


def test_no_number_of_the_summary_is_minus_zero(bench: Callable[..., Bench]) -> None:
    summary = dataclasses.replace(
        bench().server.summary(), mean_speed=-0.001, last_speed=-0.004, distance=-0.4
    )
    assert "-0.0" not in summary.to_text()


def test_lost_commands_have_the_names_of_the_receivers_counters(
    bench: Callable[..., Bench],
) -> None:
    here = bench()
    everything = dataclasses.replace(KEEP, engine_brake=0.2, retarder=0.2, xbr_mode=XbrMode.MAXIMUM)
    here.serve(0.5, everything)
    names = set(here.server.summary().accepted)
    here.serve(0.5)
    assert here.server.receiver.loss(here.server.time).silent == tuple(UNIT_NAMES)
    assert set(UNIT_NAMES.values()) == names


def test_command_line_prints_the_summary_of_a_diverged_truck_and_exits_with_1(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    step = Truck.step

    def broken(self: Truck, n: int = 1) -> None:
        if self.time > 0.15:
            self.data.qvel[0] = float("nan")
        step(self, n)

    monkeypatch.setattr(Truck, "step", broken)
    words = ["serve", "--bus", "virtual", "--channel", uuid.uuid4().hex, "--start-speed", "16"]
    assert cli.main([*words, "--json"]) == 1
    summary = json.loads(capsys.readouterr().out)["summary"]
    assert summary["failed"]
    assert summary["ended"].startswith("the simulation diverged")
    assert summary["duration_s"] == pytest.approx(0.16, abs=0.011)
