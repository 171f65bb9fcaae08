"""A drive over J1939 frames, the log of its bus, and the drive repeated from the log."""

from __future__ import annotations

import itertools
import math
import re
from collections import Counter
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path

import can
import cantools
import numpy as np
import pytest

from iits_mj.core.errors import BusError, InputError
from iits_mj.core.messages import Decision, VehicleCommand
from iits_mj.j1939 import Frame, command_to_frames, database_path, read_log
from iits_mj.j1939.network import CONTROLLER
from iits_mj.road import Route
from iits_mj.simulation import DriveConfig, Simulation, Telemetry
from iits_mj.simulation import driver as log_driver
from iits_mj.simulation.drive_log import BusLog
from iits_mj.simulation.driver import LogDriver
from iits_mj.simulation.lock_step import CommandPath
from iits_mj.truck import Truck
from tests.simulation.scripted import DRIVEN, drive, simulation, table, watch

LEFT_AT_3 = {3: Decision.LEFT}
THERE_AND_BACK = {20: Decision.LEFT, 40: Decision.RIGHT}
SUFFIXES = ("asc", "blf", "csv", "log", "trc")
SHORT = 12.0


class EveryCycle:
    """Sends all messages every 20 ms, so that only the signal resolution changes commands."""

    def __init__(self) -> None:
        self.cycles = 0

    def frames(self, command: VehicleCommand, time: float) -> list[Frame]:
        self.cycles += 1
        return command_to_frames(command, self.cycles, time)


@dataclass
class Logged:
    telemetry: Telemetry
    logs: dict[str, Path]


@pytest.fixture(scope="module")
def direct() -> Telemetry:
    return drive(LEFT_AT_3, duration=SHORT)


@pytest.fixture(scope="module")
def over_bytes() -> Telemetry:
    return drive(LEFT_AT_3, duration=SHORT, commands="j1939")


@pytest.fixture(scope="module")
def logged(tmp_path_factory: pytest.TempPathFactory) -> Logged:
    folder = tmp_path_factory.mktemp("logs")
    paths = {suffix: folder / f"drive.{suffix}" for suffix in SUFFIXES}
    with simulation(LEFT_AT_3, duration=SHORT, commands="j1939") as driven, ExitStack() as stack:
        logs = [stack.enter_context(BusLog(path, driven.truck)) for path in paths.values()]
        telemetry = watch(driven, *logs)
    return Logged(telemetry, paths)


def by_log(path: Path, duration: float = 60.0, **settings: object) -> tuple[Telemetry, Simulation]:
    def driver(route: Route, truck: Truck) -> LogDriver:
        return LogDriver(lambda: read_log(path), route)

    telemetry = Telemetry(None)
    config = DriveConfig(traffic_mode="none", duration=duration, **settings)  # type: ignore[arg-type]
    with Simulation(config, driver=driver, visuals=False) as replay:
        assert isinstance(replay.driver, LogDriver)
        replay.run([telemetry, replay.driver])
    return telemetry, replay


COMPARED = ("station [m]", "offset [m]", "yaw [rad]", "speed [m/s]")


def apart(one: Telemetry, other: Telemetry, column: str) -> float:
    return float(np.abs(one.column(column) - other.column(column)).max())


def test_drive_over_bytes_equals_the_direct_drive_up_to_the_signal_resolution(
    direct: Telemetry,
) -> None:
    bus = drive(LEFT_AT_3, CommandPath(over_bytes=True, sender=EveryCycle), duration=SHORT)
    assert np.ptp(direct.column("offset [m]")) > 3.5
    assert 0.0 < apart(bus, direct, "station [m]") < 0.01
    assert apart(bus, direct, "offset [m]") < 0.01
    assert apart(bus, direct, "yaw [rad]") < 1e-3
    assert apart(bus, direct, "speed [m/s]") < 0.01


def test_messages_at_their_own_rates_leave_the_drive_within_a_decimetre(
    direct: Telemetry, over_bytes: Telemetry
) -> None:
    assert 0.0 < apart(over_bytes, direct, "station [m]") < 0.1
    assert apart(over_bytes, direct, "offset [m]") < 0.01
    assert apart(over_bytes, direct, "speed [m/s]") < 0.02


@pytest.mark.slow
@pytest.mark.parametrize("payload", [36_000.0, 0.0])
def test_a_minute_with_two_lane_changes_is_nearly_the_same_over_bytes(payload: float) -> None:
    settings = {"duration": 60.0, "payload": payload}
    straight = drive(THERE_AND_BACK, **settings)
    steps = drive(THERE_AND_BACK, CommandPath(over_bytes=True, sender=EveryCycle), **settings)
    rates = drive(THERE_AND_BACK, commands="j1939", **settings)
    for name, other in (("signals' steps", steps), ("messages' rates", rates)):
        # `pytest -s` shows the figures of docs/j1939_drive.md.
        found = ", ".join(f"{apart(other, straight, c):.2g} {c}" for c in COMPARED)
        print(f"\n{payload:g} kg, {name}: {found}")
    assert straight.column("lane_changes [-]")[-1] == 2
    # The steering wheel may rest one signal step off within the play: the truck drifts by some
    # centimetres until the controller crosses the play.
    assert 0.0 < apart(steps, straight, "station [m]") < 0.25
    for other in (steps, rates):
        assert apart(other, straight, "station [m]") < 0.25
        assert apart(other, straight, "offset [m]") < 0.05
        assert apart(other, straight, "yaw [rad]") < 2.5e-3
        assert apart(other, straight, "speed [m/s]") < 0.06


def test_drive_over_bytes_repeats_bit_for_bit_and_logging_changes_nothing(
    over_bytes: Telemetry, logged: Logged
) -> None:
    assert np.array_equal(table(over_bytes), table(logged.telemetry), equal_nan=True)


def test_reset_repeats_a_drive_over_bytes() -> None:
    with simulation({}, duration=1.0, commands="j1939") as driven:
        first = watch(driven)
        driven.reset()
        assert np.array_equal(table(first), table(watch(driven)), equal_nan=True)


def test_log_repeats_the_drive_bit_for_bit(logged: Logged) -> None:
    again, replay = by_log(logged.logs["asc"])
    assert replay.ended == "reached the end of the log"
    assert np.array_equal(table(again, DRIVEN), table(logged.telemetry, DRIVEN), equal_nan=True)
    assert isinstance(replay.driver, LogDriver)
    assert not replay.driver.receiver.rejected
    assert replay.driver.lane_changes == 1


def test_plan_of_a_drive_by_a_log_is_unknown(logged: Logged) -> None:
    again, _ = by_log(logged.logs["blf"], duration=1.0)
    assert np.isnan(again.column("planned_speed [m/s]")).all()
    assert np.isnan(again.column("reference_speed [m/s]")).all()


@pytest.mark.parametrize("suffix", SUFFIXES)
def test_every_log_format_has_the_same_frames_at_the_same_microseconds(
    logged: Logged, suffix: str
) -> None:
    for frame, other in itertools.zip_longest(
        read_log(logged.logs[suffix]), read_log(logged.logs["asc"])
    ):
        assert (frame.can_id, frame.data) == (other.can_id, other.data)
        assert frame.time == pytest.approx(other.time, abs=1e-9)


def test_other_tools_read_plausible_values_at_the_rates_of_the_messages(logged: Logged) -> None:
    # python-can and cantools alone.
    database = cantools.database.load_file(database_path())
    names = {message.frame_id: message.name for message in database.messages}
    signals: dict[str, list[dict[str, float]]] = {}
    times: dict[str, list[float]] = {}
    for message in can.LogReader(logged.logs["blf"]):
        assert message.is_extended_id
        name = names.get(message.arbitration_id)
        if name is not None:
            decoded = database.decode_message(
                message.arbitration_id, message.data, decode_choices=False
            )
            signals.setdefault(name, []).append(decoded)
            times.setdefault(name, []).append(message.timestamp)
    for name, period in (("EEC1", 0.02), ("VDC2", 0.01), ("XBR", 0.02), ("CCVS1", 0.1)):
        assert np.diff(times[name]) == pytest.approx(period, abs=2e-6)
        assert len(times[name]) == pytest.approx(SHORT / period, abs=1.0)
    speeds = [decoded["engine_speed_rpm"] for decoded in signals["EEC1"]]
    assert 900.0 < min(speeds) < max(speeds) < 2000.0
    driven = 3.6 * logged.telemetry.column("speed [m/s]")
    wheels = [decoded["wheel_based_speed_kph"] for decoded in signals["CCVS1"]]
    assert min(wheels) == pytest.approx(driven.min(), abs=0.5)
    assert max(wheels) == pytest.approx(driven.max(), abs=0.5)
    angles = [decoded["steering_wheel_angle_request"] for decoded in signals["IITS_COMMAND"]]
    reported = logged.telemetry.column("command_steering_wheel_angle [rad]")
    assert max(angles) == pytest.approx(reported.max(), abs=0.02)
    for name in ("XBR", "IITS_COMMAND"):
        counts = [
            decoded[next(key for key in decoded if key.endswith("_counter"))]
            for decoded in signals[name]
        ]
        assert all((b - a) % 16 == 1 for a, b in itertools.pairwise(counts))


def test_direct_commands_pass_unchanged_and_listeners_get_their_frames() -> None:
    path = CommandPath(over_bytes=False)
    heard: list[Frame] = []
    command = VehicleCommand(accelerator_pedal=0.3333, steering_wheel_angle=0.12345)
    assert path.transmit(command, 0.0, [heard.append]) is command
    assert {frame.source for frame in heard} == {CONTROLLER}
    assert len(heard) == 5
    assert not path.receiver.accepted


def test_log_of_direct_commands_repeats_the_drive_up_to_the_signal_resolution(
    tmp_path: Path,
) -> None:
    path = tmp_path / "drive.log"
    with simulation({}, duration=6.0) as driven, BusLog(path, driven.truck) as log:
        telemetry = watch(driven, log)
    again, _ = by_log(path)
    assert apart(again, telemetry, "station [m]") < 0.05
    assert apart(again, telemetry, "offset [m]") < 0.005


def test_drive_continues_without_its_closed_log_and_a_second_log_is_equal(tmp_path: Path) -> None:
    paths = [tmp_path / "first.log", tmp_path / "second.log"]
    with simulation({}, duration=1.0, commands="j1939") as driven:
        for path in paths:
            driven.reset()
            with BusLog(path, driven.truck) as log:
                driven.run([log])
        driven.reset()
        driven.run()
    first, second = (list(read_log(path)) for path in paths)
    assert first == second


def frames_without(path: Path, *pgns: int) -> list[Frame]:
    return [frame for frame in read_log(path) if frame.pgn not in pgns]


def driven_by(frames: list[Frame], duration: float = 5.0, **settings: object) -> LogDriver:
    def driver(route: Route, truck: Truck) -> LogDriver:
        return LogDriver(lambda: frames, route, **settings)  # type: ignore[arg-type]

    config = DriveConfig(traffic_mode="none", duration=duration)
    with Simulation(config, driver=driver, visuals=False) as replay:
        replay.run()
    assert isinstance(replay.driver, LogDriver)
    return replay.driver


def test_accelerator_of_a_log_without_steering_is_not_obeyed(logged: Logged) -> None:
    driver = driven_by(frames_without(logged.logs["asc"], 0xFF00), duration=1.0)
    assert driver.receiver.accepted["EEC2"] > 0
    assert driver.receiver.command(0.9).accelerator_pedal == 0.0


def test_only_the_selected_sender_of_a_log_is_obeyed(logged: Logged) -> None:
    frames = list(read_log(logged.logs["asc"]))
    driver = driven_by(frames, duration=1.0, source=0x21)
    assert not driver.receiver.accepted
    assert driver.receiver.ignored["XBR: from an address that is not obeyed"] == 51


def test_accelerator_is_released_after_the_last_command_of_a_log() -> None:
    frames = [
        frame
        for k in range(50)
        for frame in command_to_frames(VehicleCommand(accelerator_pedal=0.5), k, 0.02 * k)
    ]
    # A later frame of another sender extends the log.
    frames.append(Frame(0x18FEF100, b"\xff" * 8, 2.0))
    driver = driven_by(frames, duration=1.9)
    assert driver.receiver.command(0.98).accelerator_pedal == pytest.approx(0.5, abs=0.01)
    assert driver.receiver.command(1.9).accelerator_pedal == 0.0


def test_a_log_whose_clock_jumps_by_years_ends_at_the_jump(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    frames = [
        frame for k in range(10) for frame in command_to_frames(VehicleCommand(), k, 0.02 * k)
    ]
    year = 86_400.0 * 365.0

    def drive_by(*later: float) -> Simulation:
        log = frames + [Frame(0x18FEF100, b"\xff" * 8, time) for time in later]

        def driver(route: Route, truck: Truck) -> LogDriver:
            return LogDriver(lambda: log, route)

        config = DriveConfig(traffic_mode="none", duration=100.0, start_speed=0.0)
        with Simulation(config, driver=driver, visuals=False) as replay:
            assert isinstance(replay.driver, LogDriver)
            replay.run([replay.driver])
        return replay

    replay = drive_by(year)
    assert replay.time < 0.5
    assert re.search(r"frame 51 \(18FEF100\) comes 3153\d{4} s after .*60 s", replay.ended)
    # A shorter silence does not end the drive.
    monkeypatch.setattr(log_driver, "LONGEST_SILENCE", 2.0)
    replay = drive_by(2.1, year)
    assert replay.time == pytest.approx(2.1, abs=0.2)
    assert "frame 52 " in replay.ended


def test_empty_log_and_unknown_format_are_refused(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="no J1939 frame"):
        driven_by([])
    with (
        simulation({}, duration=1.0) as driven,
        pytest.raises(BusError, match="suffix"),
    ):
        BusLog(tmp_path / "drive.xyz", driven.truck)


def test_reports_and_commands_of_a_log_are_in_the_order_of_time(logged: Logged) -> None:
    frames = list(read_log(logged.logs["asc"]))
    assert frames[0].time == 0.0
    assert all(a.time <= b.time for a, b in itertools.pairwise(frames))
    senders = Counter(frame.source for frame in frames)
    assert senders[CONTROLLER] == pytest.approx(160.0 * SHORT, rel=0.02)
    assert math.isclose(frames[-1].time, SHORT, abs_tol=1e-6)
