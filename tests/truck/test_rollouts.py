import numpy as np
import pytest

from iits_mj.core.errors import InputError
from iits_mj.model.sensor_table import sensor_unit
from iits_mj.road import Route
from iits_mj.truck import Truck
from iits_mj.truck.placement import TruckPlacement
from iits_mj.truck.rollouts import Scenario, roll_out

ROAD = Route.straight(length=3_000.0, lanes=2)
SLIPPERY = Route.straight(length=3_000.0, lanes=2, friction=0.2)
ROLLING = TruckPlacement(station=100.0, speed=15.0)


def test_a_rollout_equals_the_drive_of_one_truck_bit_for_bit():
    scenarios = [
        Scenario(route=ROAD, payload=payload, place=ROLLING) for payload in (0.0, 36_000.0)
    ]
    angle = np.linspace(0.0, 0.6, 20)
    drives = roll_out(
        scenarios,
        {"steering_wheel_angle": angle, "accelerator_pedal": [[0.2], [0.8]]},
        duration=2.0,
        signals=("tractor_gyro", "engine_speed", "tractor_position"),
    )
    truck = Truck.load(36_000.0, route=ROAD, visuals=False)
    truck.reset(station=100.0, speed=15.0)
    for instant in range(20):
        truck.command(steering_wheel_angle=angle[instant], accelerator_pedal=0.8)
        truck.step(50)
        truck.observe()
        np.testing.assert_array_equal(
            drives["tractor_gyro"][1, instant], truck.sensor("tractor_gyro")
        )
        assert drives["engine_speed"][1, instant] == truck.read("engine_speed")
    assert drives.time[-1] == pytest.approx(2.0)
    assert not drives.diverged.any()
    # The empty truck with less pedal responds differently.
    assert not np.array_equal(drives["tractor_gyro"][0], drives["tractor_gyro"][1])


def test_the_number_of_threads_changes_nothing():
    scenarios = [
        Scenario(route=ROAD, place=TruckPlacement(station=100.0, speed=float(speed)))
        for speed in np.linspace(5.0, 20.0, 6)
    ]
    runs = [
        roll_out(scenarios, {"xbr_demand": -2.0, "xbr_mode": 2.0}, duration=1.0, threads=threads)
        for threads in (1, 2)
    ]
    for name, values in runs[0].values.items():
        np.testing.assert_array_equal(values, runs[1][name])


def test_less_friction_and_worn_tires_lengthen_braking():
    overlay = {"tire_common": {"friction_longitudinal": 0.5}}
    drives = roll_out(
        [
            Scenario(route=ROAD, place=ROLLING, payload=0.0),
            Scenario(route=SLIPPERY, place=ROLLING, payload=0.0),
            Scenario(route=ROAD, place=ROLLING, payload=0.0, parameters=overlay),
        ],
        {"brake_pedal": 1.0},
        duration=1.5,
        signals=("tractor_velocity",),
    )
    dry, wet, worn = drives["tractor_velocity"][:, -1, 0]
    assert wet > dry + 3.0
    assert dry + 0.3 < worn < wet
    assert drives.units["tractor_velocity"] == "m/s"


def test_every_sensor_of_the_model_has_a_unit_and_as_many_components():
    model = Truck.load(0.0, visuals=False).model
    for number in range(model.nsensor):
        name, size = model.sensor(number).name, int(model.sensor_dim[number])
        unit = sensor_unit(name)
        assert unit.unit
        assert len(unit.components) in (0, size)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"controls": {"pedal": 1.0}}, "unknown command 'pedal'"),
        ({"controls": {"accelerator_pedal": 2.0}}, "outside"),
        ({"controls": {"accelerator_pedal": np.nan}}, "outside"),
        ({"controls": {"accelerator_pedal": np.zeros(7)}}, "does not fit"),
        ({"signals": ("speed",)}, "sensor 'speed' is unknown"),
        ({"duration": 0.25}, "duration"),
        ({"period": 0.0011}, "period"),
        ({"scenarios": []}, "at least one scenario"),
    ],
)
def test_wrong_arguments_are_refused(change, message):
    arguments = {
        "scenarios": [Scenario(route=ROAD)],
        "controls": {},
        "duration": 0.5,
    } | change
    with pytest.raises(InputError, match=message):
        roll_out(arguments.pop("scenarios"), arguments.pop("controls"), **arguments)


def test_an_unrecorded_signal_is_refused_by_name():
    drives = roll_out([Scenario(route=ROAD)], {}, duration=0.1, signals=("gear",))
    with pytest.raises(InputError, match="fuel_used"):
        drives["fuel_used"]
