"""State, report and placement of a truck alone and of chains of units."""

import itertools
import math

import pytest

from iits_mj.core.units import GRAVITY
from iits_mj.model.statics import wheel_height
from iits_mj.parameters.mass_state import axle_loads_by_name
from iits_mj.road.design import Design
from iits_mj.truck import Truck
from tests.combinations import load

NAMES = ("alone", "b_double", "dolly", "rigid_drawbar", "a_double")
SIDES = ("left", "right")
RADIUS = 80.0


@pytest.fixture(scope="module")
def bend():
    """A left bend that climbs and leans inward."""
    design = Design(
        name="bend",
        speed_limit=14.0,
        alignment=((300.0, 1.0 / RADIUS, 1.0 / RADIUS, 0.04, 0.04),),
        initial_grade=0.03,
    )
    return design.route()


@pytest.fixture(params=NAMES)
def placed(request, bend):
    """A truck at 5 m/s in the bend, half a meter left of the line."""
    truck = Truck.load(0.0, parameters=load(request.param), route=bend, visuals=False)
    truck.reset(station=150.0, offset=0.5, speed=5.0)
    truck.observe()
    return truck


def yaw(truck, unit):
    axes = truck.data.body(unit).xmat.reshape(3, 3)
    return math.atan2(axes[1, 0], axes[0, 0])


def test_units_placed_in_a_bend_lie_on_the_road(placed, bend):
    p = placed.parameters
    loads = axle_loads_by_name(p, 0.0)
    for axle in p.axles:
        for side in SIDES:
            x, y, z = placed.data.body(f"{axle.name}_{side}_wheel").xpos.tolist()
            station, offset = bend.locate(x, y, 140.0)
            above = z - float(bend.evaluate(station, offset).z)
            assert above == pytest.approx(wheel_height(p, axle, loads[axle.name]), abs=0.03)
    for unit in p.units[1:]:
        x, y, _ = placed.data.site(f"{unit.name}_axle_center").xpos.tolist()
        assert bend.locate(x, y, 140.0)[1] == pytest.approx(0.5, abs=0.02)


@pytest.mark.parametrize("name", NAMES)
def test_units_placed_in_a_bend_stand_there_on_all_axles(name, bend):
    p = load(name)
    truck = Truck.load(0.0, parameters=p, route=bend, visuals=False)
    truck.reset(station=150.0)
    truck.command(parking_brake=1)
    before, total = truck.observe(), []
    for _ in range(100):
        truck.step(5)
        total.append(sum(truck.report().axle_loads))
    weight = p.gross_mass(0.0) * GRAVITY
    assert total == pytest.approx([weight] * 100, rel=0.15)
    assert total[-1] == pytest.approx(weight, rel=0.01)
    static = list(axle_loads_by_name(p, 0.0).values())
    assert truck.report().axle_loads == pytest.approx(static, rel=0.25)
    assert math.hypot(truck.observe().x - before.x, truck.observe().y - before.y) < 0.05


def test_state_has_the_angle_of_every_coupling(placed):
    placed.step(100)
    state, p = placed.observe(), placed.parameters
    yaws = [yaw(placed, unit.name) for unit in p.units]
    angles = [(a - b + math.pi) % (2.0 * math.pi) - math.pi for a, b in itertools.pairwise(yaws)]
    found = [state.articulation, *state.rear_articulations][: len(angles)]
    # On the leaning road, the hinges' angles differ little from those in the plane.
    assert found == pytest.approx(angles, abs=2e-3)
    assert len(state.rear_articulations) == max(len(p.units) - 2, 0)
    assert len(state.rear_articulation_rates) == len(state.rear_articulations)
    # In a left bend every unit is turned less to the left than the one ahead.
    assert all(angle > 0.01 for angle in angles)
    x, y, _ = placed.data.site(f"{p.last.name}_axle_center").xpos.tolist()
    offset = placed.route.locate(x, y, placed.trailer_station)[1]
    assert state.trailer_offset == pytest.approx(offset, abs=1e-6)
    assert state.trailer_yaw_rate == float(placed.sensor(f"{p.last.name}_gyro")[2])
    assert state.mass == p.gross_mass(0.0)


def test_rates_of_the_couplings_are_the_changes_of_their_angles(bend):
    truck = Truck.load(0.0, parameters=load("dolly"), route=bend, visuals=False)
    truck.reset(station=150.0, speed=5.0)
    truck.command(steering_wheel_angle=4.0, transmission_mode=1)
    truck.step(200)
    before = truck.observe()
    truck.step(10)
    after = truck.observe()
    for k in range(2):
        change = after.rear_articulations[k] - before.rear_articulations[k]
        mean = 0.5 * (after.rear_articulation_rates[k] + before.rear_articulation_rates[k])
        assert change / (after.time - before.time) == pytest.approx(mean, rel=0.02, abs=2e-4)


def test_a_truck_without_trailer_has_no_angle(bend):
    truck = Truck.load(parameters=load("alone"), route=bend, visuals=False)
    truck.reset(station=150.0)
    state = truck.observe()
    assert (state.articulation, state.articulation_rate) == (0.0, 0.0)
    assert state.rear_articulations == ()


def test_report_has_all_axle_loads_and_the_masses(placed):
    p = placed.parameters
    placed.step(10)
    report = placed.report()
    assert len(report.axle_loads) == len(p.axles)
    assert len(report.wheel_speeds) == 2 * len(p.lead.axles)
    assert report.tractor_mass == p.lead.mass
    assert report.trailer_mass == pytest.approx(sum(unit.mass for unit in p.units[1:]))
    assert report.wheel_speeds == pytest.approx([5.0] * 2 * len(p.lead.axles), abs=0.3)


@pytest.mark.parametrize(("name", "axle"), [("two_steered", "axle3"), ("alone", "axle3")])
def test_second_rear_axle_of_the_report_is_the_second_that_is_not_steered(name, axle):
    truck = Truck.load(parameters=load(name), visuals=False)
    truck.reset(speed=15.0)
    truck.command(xbr_demand=-2.0, xbr_mode=2)
    truck.step(400)
    report, lead = truck.report(), truck.parameters.lead
    index = [a.name for a in lead.axles].index(f"tractor_{axle}")
    pressures = truck.sensor("brake_pressures")[2 * index : 2 * index + 2]
    assert report.brake_pressure_rear2_left == pressures[0] > 0.0
    assert report.brake_pressure_rear2_right == pressures[1]


def test_a_tractor_with_one_rear_axle_reports_no_second_one():
    overlay = {"remove": ["units.tractor.axles.axle3"]}
    truck = Truck.load(parameters=overlay, visuals=False)
    truck.step(1)
    assert truck.report().brake_pressure_rear2_left is None


def test_an_articulation_bends_the_first_coupling_only(bend):
    truck = Truck.load(0.0, parameters=load("b_double"), route=bend, visuals=False)
    truck.reset(station=150.0, articulation=0.3)
    state = truck.observe()
    assert state.articulation == pytest.approx(0.3, abs=1e-3)
    assert state.rear_articulations == pytest.approx((0.0,), abs=1e-3)
