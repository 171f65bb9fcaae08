import dataclasses
import math

import numpy as np
import pytest

from iits_mj.core.errors import InputError
from iits_mj.j1939 import Frame, ReferenceTorques, StateReceiver, broadcast, encode, pack, read_log
from iits_mj.j1939.configuration import (
    ConfigurationReceiver,
    ConfigurationSender,
    engine_configuration,
    retarder_configurations,
)
from iits_mj.j1939.groups import EC1, EEC1, EEC3, ERC1, RC
from iits_mj.j1939.network import DRIVELINE_RETARDER, ENGINE, ENGINE_RETARDER
from iits_mj.parameters import TruckParameters
from tests.paths import outside

PARAMETERS = TruckParameters.load()
RPM = 60.0 / (2.0 * math.pi)


def curve(group, stem, numbers):
    points = sorted(
        (
            group.number(f"{stem}_speed_point_{i}_rpm"),
            group.number(f"{stem}_torque_point_{i}_percent"),
        )
        for i in numbers
    )
    return [p[0] for p in points], [p[1] for p in points]


def sent(seconds, tick=0.01):
    sender = ConfigurationSender(PARAMETERS)
    ticks = range(round(seconds / tick))
    return [frame for i in ticks for frame in sender.frames(round(i * tick, 6))]


def test_torque_points_of_the_engine_follow_its_full_load_curve():
    engine = PARAMETERS.engine
    speeds, percents = curve(engine_configuration(PARAMETERS), "engine", (1, 3, 4, 5, 2))
    drag = np.interp(engine.full_load_speed, engine.drag_speed, engine.drag_torque)
    indicated = 100.0 * (engine.full_load_torque + drag) / engine.reference_torque
    sent_curve = np.interp(engine.full_load_speed * RPM, speeds, percents)
    # Five points approximate a curve of twelve.
    assert np.abs(sent_curve - indicated).max() < 5.0
    assert max(percents) == pytest.approx(indicated.max(), abs=0.5)
    assert speeds[0] == pytest.approx(engine.idle_speed * RPM)


def test_engine_has_no_torque_at_its_high_idle():
    engine = engine_configuration(PARAMETERS)
    begin, end = engine.engine_speed_point_2_rpm, engine.engine_speed_point_6_rpm
    fall = engine.governor_gain_percent_per_rpm * (end - begin)
    assert fall == pytest.approx(engine.engine_torque_point_2_percent)
    assert end == pytest.approx(PARAMETERS.engine.governed_speed * RPM)


def test_engine_brake_gives_its_rated_power_at_its_rated_speed():
    group = retarder_configurations(PARAMETERS)[ENGINE_RETARDER]
    speed = group.number("retarder_speed_point_5_rpm") / RPM
    torque = -group.number("retarder_torque_point_5_percent") / 100.0
    power = speed * torque * group.number("reference_retarder_torque_nm")
    assert power == pytest.approx(PARAMETERS.engine.engine_brake_power)
    # It has no torque at idle, and never more than the rated torque.
    _, percents = curve(group, "retarder", range(1, 6))
    assert percents[0] == 0.0
    assert min(percents) == -100.0


def test_retarder_holds_its_torque_to_its_power_limit():
    group = retarder_configurations(PARAMETERS)[DRIVELINE_RETARDER]
    speeds, percents = curve(group, "retarder", range(1, 6))
    reference = group.number("reference_retarder_torque_nm")
    assert percents == [*sorted(percents[:2], reverse=True), -100.0, -100.0, percents[4]]
    power = [-p / 100.0 * reference * s / RPM for s, p in zip(speeds, percents, strict=True)]
    assert power[3] == pytest.approx(PARAMETERS.retarder.power_max)
    assert power[4] == pytest.approx(PARAMETERS.retarder.power_max)


def test_a_truck_without_retarder_sends_no_retarder_configuration():
    none = dataclasses.replace(PARAMETERS.retarder, torque_max=0.0)
    bare = dataclasses.replace(PARAMETERS, retarder=none)
    assert set(retarder_configurations(bare)) == {ENGINE_RETARDER}


def test_a_listener_receives_the_reference_torques_of_the_truck():
    receiver = ConfigurationReceiver(ReferenceTorques(1000.0, 1000.0, 1000.0))
    assert sum(receiver.receive(frame) for frame in sent(1.0)) == 3
    # The resolution on the bus is 1 N m.
    for learned, true in zip(
        dataclasses.astuple(receiver.references),
        dataclasses.astuple(ReferenceTorques.of(PARAMETERS)),
        strict=True,
    ):
        assert learned == pytest.approx(true, abs=0.5)


def test_configurations_are_repeated_every_5_s_by_each_unit():
    frames = [frame for frame in sent(11.0) if frame.pgn == 0xEC00]
    for source in (ENGINE, ENGINE_RETARDER, DRIVELINE_RETARDER):
        times = [frame.time for frame in frames if frame.source == source]
        assert times == pytest.approx([0.0, 5.0, 10.0])


def test_a_new_drive_repeats_the_broadcasts_from_its_start():
    sender = ConfigurationSender(PARAMETERS)

    def drive():
        return [frame for tick in range(100) for frame in sender.frames(0.01 * tick)]

    first = drive()
    assert first[0].time == 0.0
    assert drive() == first


def test_percent_torque_refers_to_the_engines_own_reference_torque():
    receiver = StateReceiver(references=ReferenceTorques(engine=2700.0))
    receiver.receive(encode(EEC1(actual_engine_torque_percent=50.0, engine_speed_rpm=1200.0)))
    receiver.receive(encode(EEC3(nominal_friction_torque_percent=0.0)))
    receiver.receive(encode(ERC1(actual_retarder_torque_percent=0.0), source=ENGINE_RETARDER))
    assert receiver.state().engine_torque == pytest.approx(1350.0)
    for frame in broadcast(65251, pack(EC1(reference_engine_torque_nm=2000.0)), ENGINE):
        receiver.receive(frame)
    assert receiver.state().engine_torque == pytest.approx(1000.0)


@pytest.mark.parametrize(
    "group",
    [
        EC1(),
        EC1(reference_engine_torque_nm=0.0),
        RC(reference_retarder_torque_nm=500.0),
        RC(reference_retarder_torque_nm=500.0, retarder_location=5.0),
    ],
)
def test_configuration_without_a_valid_reference_torque_changes_nothing(group):
    known = ReferenceTorques(1.0, 2.0, 3.0)
    receiver = ConfigurationReceiver(known)
    pgn = 65251 if isinstance(group, EC1) else 65249
    assert not any(receiver.receive(frame) for frame in broadcast(pgn, pack(group), 0))
    assert receiver.references == known


def test_malformed_configurations_are_ignored_and_times_must_be_finite():
    receiver = ConfigurationReceiver(ReferenceTorques())
    assert not any(receiver.receive(frame) for frame in broadcast(65251, bytes(20), 0))
    assert not receiver.receive(Frame(0x1CECFF00, b"", math.nan))
    with pytest.raises(InputError, match="nan"):
        ConfigurationSender(PARAMETERS).frames(math.nan)


def test_reference_torques_of_a_real_truck_are_read_from_its_bus():
    receiver = ConfigurationReceiver(ReferenceTorques(retarder=3500.0))
    for frame in read_log(outside("j1939/KWTruck.txt")):
        receiver.receive(frame)
    # Engine and exhaust brake; it has no other retarder.
    assert receiver.references == ReferenceTorques(1109.0, 450.0, 3500.0)
