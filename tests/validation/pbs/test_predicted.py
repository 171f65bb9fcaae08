import dataclasses

import pytest

from iits_mj.parameters import TruckParameters
from iits_mj.validation.pbs.limits import reached
from iits_mj.validation.pbs.predicted import predicted

TRUCK = TruckParameters.load()


def test_semitrailer_reaches_general_access():
    values = predicted(TRUCK, TRUCK.payload_max)
    levels, overall = reached(values)
    assert set(levels.values()) == {overall} == {1}
    assert 5.5 < values["swept_path"] < 6.5
    assert 0.0 < values["off_tracking"] < 0.6


def test_b_double_reaches_level_2_and_amplifies_less_than_an_a_double():
    b_double, a_double = (
        predicted(truck, truck.payload_max)
        for truck in map(TruckParameters.load, ("b_double", "a_double"))
    )
    assert reached(b_double)[1] == 2
    assert 1.4 * b_double["amplification"] < a_double["amplification"] < 5.7
    assert b_double["off_tracking"] < a_double["off_tracking"]
    assert b_double["yaw_damping"] > a_double["yaw_damping"] > 0.15


def test_single_unit_has_no_measures_of_towed_units():
    alone = dataclasses.replace(TRUCK, units=TRUCK.units[:1])
    values = predicted(alone, 0.0)
    assert not {"off_tracking", "amplification", "front_paths", "front_maxima"} & set(values)
    assert values["swept_path"] < predicted(TRUCK, 0.0)["swept_path"]


@pytest.mark.parametrize("overhang", [2.0, 3.5])
def test_tail_swing_grows_with_the_body_behind_the_axles(overhang):
    trailer = TRUCK.units[1]
    last = trailer.axles[-1].position
    length = last + overhang + trailer.front_overhang
    longer = dataclasses.replace(trailer, length=length + 1.0)
    shorter = dataclasses.replace(trailer, length=length)
    swings = [
        predicted(dataclasses.replace(TRUCK, units=(TRUCK.lead, unit)), 0.0)["tail_swing"]
        for unit in (shorter, longer)
    ]
    assert swings[0] < swings[1]
