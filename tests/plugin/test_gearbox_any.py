"""The adaptive shift strategy without tables, for any number of gears and any engine."""

import numpy as np
import pytest

from iits_mj.core.messages import VehicleCommand
from iits_mj.parameters import TruckParameters
from iits_mj.road import Route
from iits_mj.truck import Truck
from iits_mj.validation.longitudinal.hills import sloping
from tests.plugin.driveline_rig import PARAMETERS, Case, constant, drive, reversals
from tests.plugin.test_gear_losses import AXLE_MAP, DRAG, blocks, gear_loss, numbers
from tests.plugin.test_powertrain_auxiliaries import RATE
from tests.plugin.vehicle_sled import KMH

TABLES = [f"{way}_{key}" for way in ("upshift", "downshift") for key in ("gear", "pedal", "speed")]
WITHOUT_TABLES = {"shift_strategy": "adaptive"} | dict.fromkeys(TABLES, "")


def gears(count, lowest):
    """Returns the attributes of a gearbox with `count` gears from the ratio `lowest` to 1."""
    return WITHOUT_TABLES | {
        "ratios": numbers(np.geomspace(lowest, 1.0, count)),
        "gear_inertias": numbers(np.full(count, 0.2)),
        "efficiency": numbers(np.linspace(0.97, 0.99, count)),
        "start_gear": str(1 if count < 6 else count // 4),
        "reverse_ratio": str(lowest),
    }


# A smaller engine that turns faster, with a map of the fuel rate; all losses by maps.
SPEEDS = (70, 120, 190, 260)
OTHER_ENGINE = RATE | {
    "idle_speed": "70",
    "governed_speed": "260",
    "reference_torque": "1100",
    "full_load_speed": numbers(SPEEDS),
    "full_load_torque": "600 1100 1050 800",
    "drag_speed": "70 260",
    "drag_torque": "60 110",
    "pedal_map_speed": "70 260",
    "pedal_map_pedal": "0 1",
    "pedal_map_torque": "0 1200 0 1200",
    "engine_inertia": "1.2",
    "auxiliary_power": "4e3",
}
LOSSES = (
    AXLE_MAP
    | DRAG
    | {
        "gear_loss_speed": "0 200",
        "gear_loss_torque": "-500 0 1000",
        "gear_losses": blocks((0.0, 200.0), (-500.0, 0.0, 1000.0), gear_loss),
    }
)
TRUCKS = {
    "2": (gears(2, 2.2), 12_000.0),
    "4": (gears(4, 8.0), 18_000.0),
    "6 small": (gears(6, 6.7) | OTHER_ENGINE, 10_000.0),
    "9 small losses": (
        gears(9, 10.0) | OTHER_ENGINE | LOSSES | {"gear_loss_map": "1 " * 9},
        16_000.0,
    ),
    "12 losses": (WITHOUT_TABLES | LOSSES | {"gear_loss_map": "1 " * 12}, 40_000.0),
    "16": (gears(16, 17.0), 40_000.0),
    "18": (gears(18, 14.4), 60_000.0),
}


@pytest.mark.parametrize("name", TRUCKS)
def test_truck_shifts_up_to_its_top_gear_and_down_on_a_climb(name):
    attributes, mass = TRUCKS[name]
    count = len(attributes.get("ratios", numbers(PARAMETERS.gearbox.ratios)).split())
    torque = float(attributes.get("reference_torque", PARAMETERS.engine.reference_torque))
    flat, climb = Case(mass, 0.0, 0.0), Case(mass, 0.7 * torque / mass, 75 * KMH)
    traces = drive([flat, climb], constant(2, 150.0, [1.0, 1.0]), changes=attributes)
    gear, engine = traces["gear"], traces["engine_speed"]
    assert gear[0, 200] == float(attributes.get("start_gear", PARAMETERS.gearbox.start_gear))
    assert gear[0, -1] >= count - (count > 12)
    assert traces["speed"][0, -1] > 75 * KMH
    assert 1 <= gear[1].min() < count
    assert traces["speed"][1, -1] > 10 * KMH
    governed = float(attributes.get("governed_speed", PARAMETERS.engine.governed_speed))
    idle = float(attributes.get("idle_speed", PARAMETERS.engine.idle_speed))
    assert engine.max() < 1.1 * governed
    assert engine.min() > 0.75 * idle
    for run in gear:
        assert len(reversals(run)) <= 1


@pytest.mark.parametrize("name", TRUCKS)
def test_truck_at_part_load_cruises_at_a_low_engine_speed(name):
    attributes, mass = TRUCKS[name]
    traces = drive([Case(mass, 0.0, 70 * KMH)], constant(1, 40.0, [0.35]), changes=attributes)
    ratios = np.fromstring(attributes.get("ratios", numbers(PARAMETERS.gearbox.ratios)), sep=" ")
    assert traces["gear"][0, -1] >= len(ratios) - 1
    assert len(reversals(traces["gear"][0])) == 0


def test_a_floored_tractor_alone_does_not_stay_at_its_governor():
    truck = Truck.load(parameters=TruckParameters.load("vecto_tractor"), visuals=False)
    truck.reset()
    truck.command(VehicleCommand(accelerator_pedal=1.0))
    at_governor = 0
    while truck.time < 25.0:
        truck.step(50)
        governed = truck.parameters.engine.governed_speed
        at_governor += truck.read("engine_speed") > 0.98 * governed
    assert truck.observe().speed > 20.0
    assert at_governor * 50 * truck.model.opt.timestep < 2.0


@pytest.mark.parametrize("name", ["tractor_semitrailer_6x2", "vecto_tractor"])
def test_a_floored_start_skips_gears_upward_and_takes_no_change_back(name):
    parameters = TruckParameters.load(name)
    truck = Truck.load(parameters.payload_max, parameters=parameters, timestep=0.002)
    truck.reset()
    truck.command(VehicleCommand(accelerator_pedal=1.0))
    gears = [truck.observe().gear]
    while truck.time < 12.0:
        truck.step(25)
        gears.append(truck.observe().gear)
    found = np.array(gears)[np.flatnonzero(np.diff(gears, prepend=0))]
    assert found.tolist() == sorted(found.tolist())
    assert found[-1] >= 8


def climb(name, route, start_speed, seconds, **changes):
    """Returns speed [m/s] and gear, each of shape (n,), of a laden truck with its pedal floored."""
    parameters = TruckParameters.load(name, changes)
    truck = Truck.load(
        parameters.payload_max,
        parameters=parameters,
        route=route,
        timestep=0.005,
        visuals=False,
        plant="yaw-sideslip",
    )
    truck.reset(station=60.0, speed=start_speed)
    truck.command(VehicleCommand(accelerator_pedal=1.0))
    rows = []
    while truck.time < seconds:
        truck.step(20)
        state = truck.observe()
        rows.append((state.speed, state.gear))
    speed, gear = np.array(rows).T
    return speed, gear


@pytest.mark.parametrize(("before", "start"), [(0.0, 80.0), (0.06, 30.0), (0.09, 20.0)])
def test_laden_40_t_climb_18_percent_from_the_road_before_without_a_stop(before, start):
    """The load rises during the downshift; 18 % needs second to fourth gear."""
    route = sloping(6e3, before, ((260.0, 0.18, 30.0),))
    speed, gear = climb("vecto_40t", route, start * KMH, 90.0)
    assert speed.min() > 1.5
    assert speed[-1] > 13 * KMH
    assert 3 <= gear[-1] <= 4


@pytest.mark.parametrize("strategy", ["tables", "adaptive"])
@pytest.mark.parametrize("grade", [0.08, 0.09, 0.10])
def test_driven_wheels_that_slip_do_not_make_the_gearbox_hunt(grade, strategy):
    """55 t from walking pace. By the slip a change costs more speed than the gearbox predicts."""
    changes = {"gearbox": {"shift_strategy": strategy}}
    route = Route.straight(length=6e3, grade=grade)
    _, gear = climb("tractor_semitrailer_6x4", route, 5 * KMH, 60.0, **changes)
    steps = np.diff(gear)
    assert np.count_nonzero(steps < 0) <= 1
    assert np.count_nonzero(steps) <= 5
