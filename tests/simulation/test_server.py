"""The served truck: it reports at its rates, obeys the bus, and is safe without it."""

from __future__ import annotations

import dataclasses
import uuid
from collections import Counter
from collections.abc import Callable, Iterator
from pathlib import Path

import can
import pytest
from can.interfaces.virtual import VirtualBus

from iits_mj.errors import BusError, InputError
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
from iits_mj.j1939.network import ADDRESS_CLAIMED, request
from iits_mj.messages import VehicleCommand
from iits_mj.simulation import ServeConfig, Server
from iits_mj.simulation.server import TICK

KEEP = VehicleCommand(accelerator_pedal=0.4)


class Clock:
    """Time that passes only while somebody sleeps: a served second takes no second."""

    def __init__(self) -> None:
        self.now = 0.0

    def __call__(self) -> float:
        return self.now

    def sleep(self, seconds: float) -> None:
        self.now += seconds


class Plug(VirtualBus):
    """A virtual bus whose plug can be pulled."""

    pulled = False

    def __init__(self, *args: object, **kwargs: object) -> None:
        if Plug.pulled:
            raise can.CanInitializationError("no such device")
        super().__init__(*args, **kwargs)  # type: ignore[arg-type]

    def _check_if_open(self) -> None:
        if Plug.pulled:
            raise can.CanOperationError("network is down")
        super()._check_if_open()


class Bench:
    """A server and a controller's bus beside it, in one process and one clock."""

    def __init__(self, **settings: object) -> None:
        self.clock = Clock()
        self.told: list[str] = []
        config = ServeConfig(
            bus="virtual", channel=uuid.uuid4().hex, **{"start_speed": 16.0, **settings}
        )
        self.server = Server(
            config, tell=self.told.append, clock=self.clock, sleep=self.clock.sleep
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


def test_every_report_comes_at_its_rate(bench: Callable[..., Bench]) -> None:
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


def test_truck_obeys_the_bus_and_tells_what_it_does(bench: Callable[..., Bench]) -> None:
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


def test_only_the_sender_that_was_named_is_obeyed(bench: Callable[..., Bench]) -> None:
    here = bench(source=0x21)
    here.serve(0.5, KEEP)
    assert here.server.command.accelerator_pedal == 0.0
    assert here.server.summary().passed_over["XBR: from an address that is not obeyed"] == 25
    named = bench(source=0x2A)
    named.serve(0.5, KEEP)
    assert named.server.command.accelerator_pedal == pytest.approx(0.4)


def test_truck_stays_parked_until_somebody_commands(bench: Callable[..., Bench]) -> None:
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
    here = bench()
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
    assert [line.split(" at t")[0].split(" from t")[0] for line in here.told] == [
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


def test_truck_outlives_a_pulled_plug_and_obeys_again_after_it(
    bench: Callable[..., Bench], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(can.interfaces.BACKENDS, "virtual", (__name__, "Plug"))
    monkeypatch.setattr(Plug, "pulled", False)
    here = bench()
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
    assert sum("will be opened again" in line for line in here.told) == 1


def test_addresses_are_claimed_again_on_a_bus_that_came_back(
    bench: Callable[..., Bench], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(can.interfaces.BACKENDS, "virtual", (__name__, "Plug"))
    monkeypatch.setattr(Plug, "pulled", False)
    here = bench()
    here.serve(0.1)
    Plug.pulled = True
    for _ in range(10):
        here.server.tick()
    Plug.pulled = False
    here.heard.clear()
    here.serve(1.0)
    assert ADDRESS_CLAIMED in {frame.pgn for frame in here.heard}


def test_log_has_both_ways_of_the_bus(bench: Callable[..., Bench], tmp_path: Path) -> None:
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


def test_late_ticks_are_served_all_the_same(bench: Callable[..., Bench]) -> None:
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


def test_serving_ends_with_its_time_when_told_and_at_the_end_of_the_road(
    bench: Callable[..., Bench],
) -> None:
    timed = bench(duration=0.5)
    assert timed.server.run().ended == "reached the end of the time"
    assert timed.server.time == pytest.approx(0.5)
    told = bench()
    told.server.stop("enough")
    assert told.server.run().ended == "enough"
    end = told.server.route.length
    near = bench(start_station=end - 25.0, start_speed=20.0, duration=20.0)
    assert near.server.run().ended == "reached the end of the road"


@pytest.mark.parametrize(
    ("settings", "told"),
    [
        ({"bus": "carrier_pigeon"}, "bus 'carrier_pigeon' is not known"),
        ({"start_station": 1e6}, "is not on the route"),
        ({"start_lane": 9}, "start-lane 9 does not exist"),
        ({"on_silence": "sing"}, "use one of: release, stop"),
        ({"duration": float("nan")}, "not a finite number"),
    ],
)
def test_unusable_settings_are_one_clear_error(settings: dict[str, object], told: str) -> None:
    with pytest.raises(InputError, match=told):
        Server(ServeConfig(**{"bus": "virtual", **settings}))


def test_unusable_log_or_bus_is_one_clear_error(tmp_path: Path) -> None:
    with pytest.raises(BusError, match="suffix"):
        Server(ServeConfig(bus="virtual", can_log=tmp_path / "log.docx"))
    with pytest.raises(BusError, match="cannot be opened"):
        Server(ServeConfig(bus="udp_multicast", channel="not an address"))
