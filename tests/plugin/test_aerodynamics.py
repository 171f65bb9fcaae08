"""Air forces on the truck."""

import mujoco
import numpy as np
import pytest

from iits_mj.truck import Truck
from tests.plugin.laws_direct import law


@pytest.fixture(scope="module")
def truck():
    return Truck.load(visuals=False)


def air_force(truck, speed, wind=(0.0, 0.0, 0.0)):
    """Returns the air force on the free joint: the force with air less the force without."""
    forces = []
    calm = Truck.load(parameters={"aerodynamics": {"density": 0.0}}, visuals=False)
    for each in (truck, calm):
        each.reset(speed=speed)
        each.model.opt.wind[:] = wind
        mujoco.mj_forward(each.model, each.data)
        forces.append(each.data.qfrc_passive[:3].copy())
    truck.model.opt.wind[:] = 0
    return forces[0] - forces[1]


def test_drag_is_half_rho_cda_v_squared(truck):
    air = truck.parameters.aerodynamics
    drag = 0.5 * air.density * air.drag_area * 20.0**2
    # The hitch's play in pitch tilts the trailer by less than a milliradian at reset.
    np.testing.assert_allclose(air_force(truck, 20.0), [-drag, 0, 0], atol=1e-3 * drag)


def test_head_wind_adds_to_the_speed(truck):
    np.testing.assert_allclose(
        air_force(truck, 15.0, wind=(-5.0, 0, 0)), air_force(truck, 20.0), atol=1e-6
    )


def test_side_wind_pushes_the_truck_downwind(truck):
    force = air_force(truck, 20.0, wind=(0.0, 10.0, 0.0))
    air = truck.parameters.aerodynamics
    expected = 0.5 * air.density * air.side_area * np.hypot(20, 10) * 10
    assert force[1] == pytest.approx(expected, rel=1e-6)


ARTICULATED = """
<mujoco>
  <option timestep="0.002" gravity="0 0 0" wind="-5 3 1"/>
  <extension>
    <plugin plugin="iits.aerodynamics">
      <instance name="air">
        <config key="density" value="1.2"/>
        <config key="drag_area" value="6"/>
        <config key="side_area" value="40"/>
      </instance>
    </plugin>
  </extension>
  <worldbody>
    <body name="tractor" pos="1 2 3">
      <freejoint/>
      <inertial pos="0.5 -0.3 0.7" mass="9000" diaginertia="1e4 5e4 5e4"/>
      <body name="trailer" pos="-4 0.2 1.1">
        <joint name="yaw" axis="0 0 1"/><joint name="roll" axis="1 0 0"/>
        <inertial pos="-6 0.4 1" mass="30000" diaginertia="4e4 4e5 4e5"/>
        <body name="side" pos="-5 0.6 1.7">
          <inertial pos="0 0 0" mass="1" diaginertia="1 1 1"/>
          <plugin plugin="iits.aerodynamics" instance="air"/>
        </body>
      </body>
    </body>
  </worldbody>
</mujoco>
"""


@pytest.mark.parametrize("seed", range(3))
def test_moving_turned_and_spinning_body_has_the_force_of_mujocos_own_velocity(seed):
    model = mujoco.MjModel.from_xml_string(ARTICULATED)
    data = mujoco.MjData(model)
    rng = np.random.default_rng(seed)
    data.qpos[3:] = rng.normal(size=model.nq - 3)
    data.qvel[:] = 3 * rng.normal(size=model.nv)
    mujoco.mj_forward(model, data)
    body = model.body("side").id
    # Angular, then linear velocity of the body's origin in its own axes.
    velocity = np.zeros(6)
    mujoco.mj_objectVelocity(model, data, mujoco.mjtObj.mjOBJ_XBODY, body, velocity, 1)
    axes = data.xmat[body].reshape(3, 3)
    v = velocity[3:] - axes.T @ model.opt.wind
    force = axes @ (-0.5 * 1.2 * np.linalg.norm(v) * v * [6, 40, 0])
    expected = np.zeros(model.nv)
    mujoco.mj_applyFT(model, data, force, np.zeros(3), data.xpos[body], body, expected)
    assert data.qfrc_passive == pytest.approx(expected, rel=1e-9, abs=1e-6)


def test_wind_on_a_body_that_is_fixed_to_the_world_moves_nothing():
    model = mujoco.MjModel.from_xml_string(
        ARTICULATED.replace("<freejoint/>", "")
        .replace('<joint name="yaw" axis="0 0 1"/><joint name="roll" axis="1 0 0"/>', "")
        .replace("</worldbody>", '<body><freejoint/><geom size="1"/></body></worldbody>')
    )
    data = mujoco.MjData(model)
    mujoco.mj_step(model, data, 100)
    assert model.nv == 6
    assert not data.qfrc_passive.any()
    assert not data.qvel.any()


ANGLES, INCREASES = (
    (0.0, 0.1, 0.3),
    (0.0, 1.0, 3.0),
)  # of the law that law("air_force_in_wind") calls


def force_in_wind(mean_wind, forward, left=0.0):
    force = np.zeros(2)
    law("air_force_in_wind", float(mean_wind), float(forward), float(left), force)
    return force


def drag(forward, left):
    """Returns the drag [N] for air from any angle, by its formula; arrays of one shape."""
    angle = np.arctan2(np.abs(left), np.abs(forward))
    area = np.interp(angle, ANGLES, INCREASES)
    area = np.where(angle > ANGLES[-1], area * np.cos(angle) / np.cos(ANGLES[-1]), area)
    square = forward**2 + left**2
    return -0.6 * (6 * np.sqrt(square) * forward + area * square * np.sign(forward))


@pytest.mark.parametrize("forward", [-20.0, -1e-12, 3.0, 25.0])
@pytest.mark.parametrize("left", [-40.0, -2.0, 0.0, 1.0, 4.0])
def test_drag_area_increases_with_the_yaw_angle_of_the_air(forward, left):
    force = force_in_wind(0, forward, left)
    assert force[0] == pytest.approx(drag(forward, left), rel=1e-9, abs=1e-6)
    assert force[1] == pytest.approx(-0.6 * 40 * np.hypot(forward, left) * left)


def test_drag_is_continuous_where_the_air_comes_from_the_side():
    steps = [force_in_wind(0, forward, 10.0)[0] for forward in np.linspace(-0.1, 0.1, 21)]
    assert np.abs(np.diff(steps)).max() < 8.0
    assert steps[10] == pytest.approx(0.0, abs=1e-6)


def mean_drag(forward, wind):
    """Returns the mean drag [N] over the wind's directions by a fine sum."""
    direction = np.linspace(0.0, 2.0 * np.pi, 200_000, endpoint=False)
    return drag(forward - wind * np.cos(direction), wind * np.sin(direction)).mean()


@pytest.mark.parametrize("wind", [3.0, 8.0])
@pytest.mark.parametrize("speed", [-22.0, 0.5, 2.9, 7.3, 13.87, 24.0, 59.9, 70.0])
def test_mean_wind_gives_the_mean_of_the_drag_over_all_directions(speed, wind):
    force = force_in_wind(wind, speed)
    assert force[0] == pytest.approx(mean_drag(speed, wind), rel=2e-3)
    assert force[1] == 0


def test_mean_wind_neither_drives_nor_holds_a_truck_at_rest():
    assert abs(force_in_wind(3.0, 0.0)[0]) < 1e-9
    speeds = np.linspace(0.0, 30.0, 601)
    forces = np.array([force_in_wind(3.0, speed)[0] for speed in speeds])
    assert (np.diff(forces) < 0).all()
    # Without jumps of the slope, although the wind's own direction turns at its speed.
    slopes = np.diff(forces) / np.diff(speeds)
    assert np.abs(np.diff(slopes)).max() < 1.5


def test_mean_wind_adds_to_the_force_of_a_given_wind():
    given = force_in_wind(0, 20.0, 4.0)
    both = force_in_wind(3.0, 20.0, 4.0)
    assert both[1] == given[1]
    added = mean_drag(20.0, 3.0) - drag(20.0, 0.0)
    assert both[0] - given[0] == pytest.approx(added, rel=2e-3)


def test_plugin_reads_the_curve_and_the_mean_wind():
    keys = """<config key="drag_yaw_angle" value="0 0.1 0.3"/>
      <config key="drag_area_increase" value="0 1 3"/><config key="mean_wind" value="3"/>"""
    xml = ARTICULATED.replace("</instance>", keys + "</instance>").replace("-5 3 1", "0 0 0")
    model = mujoco.MjModel.from_xml_string(xml)
    data = mujoco.MjData(model)
    data.qvel[0] = 20.0
    mujoco.mj_forward(model, data)
    assert data.qfrc_passive[0] == pytest.approx(mean_drag(20.0, 3.0), rel=2e-3)
