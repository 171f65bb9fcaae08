import pytest

from iits_mj.core.errors import InputError
from iits_mj.simulation import DriveConfig, Simulation
from iits_mj.web.events import GUST, Events


class Trial:
    """A drive with its events."""

    def __init__(self, simulation):
        self.simulation, self.events = simulation, Events(simulation)

    def drive(self, duration):
        end = self.simulation.time + duration - 1e-6
        while self.simulation.time < end:
            assert not self.simulation.ended
            self.events.advance()
            self.simulation.cycle()


@pytest.fixture
def trial():
    config = DriveConfig(duration=500.0, density="empty", speed_planner="cruise", decision="keep")
    with Simulation(config, visuals=False) as simulation:
        yield Trial(simulation)


def test_a_leader_brakes_hard_and_drives_on(trial):
    with pytest.raises(InputError, match="no vehicle is ahead"):
        trial.events.trigger("Leader brakes hard")
    trial.events.trigger("Slow truck ahead")
    trial.drive(3.0)
    (leader,) = (v for v in trial.simulation.vehicles if v.id.startswith("convoy"))
    assert "ahead brakes" in trial.events.trigger("Leader brakes hard")
    trial.drive(1.0)
    braking = trial.simulation.vehicles.find(leader.id)
    assert braking.speed < leader.speed - 2.0
    trial.drive(12.0)
    assert trial.simulation.vehicles.find(leader.id).speed > 0.5 * leader.speed


def test_the_truck_stops_behind_a_stopped_car_and_passes_when_it_has_gone(trial):
    trial.events.trigger("Stopped car ahead")
    trial.drive(25.0)
    assert trial.simulation.frame.ego.speed < 3.0
    trial.drive(15.0)
    assert trial.simulation.frame.ego.speed > 3.0


def test_a_limit_begins_ahead_and_ends(trial):
    trial.events.trigger("Limit 40 km/h ahead")
    trial.drive(1.0)
    assert [zone.limit for zone in trial.simulation.scene.signals.zones] == [
        pytest.approx(40.0 / 3.6)
    ]
    trial.drive(62.0)
    assert not trial.simulation.scene.signals.zones


def test_a_closed_lane_is_reported(trial):
    trial.events.trigger("Lane closed ahead")
    trial.drive(8.0)
    assert any(v.id.startswith("blocker") for v in trial.simulation.vehicles)


def test_a_gust_pushes_the_truck_to_the_right_and_ends(trial):
    trial.drive(1.0)
    before = trial.simulation.frame.ego.offset
    trial.events.trigger("Gust from the left")
    trial.drive(2.0)
    wind = trial.simulation.truck.model.opt.wind
    assert abs(wind[:2] @ wind[:2]) == pytest.approx(GUST**2)
    assert trial.simulation.frame.ego.offset < before - 0.01
    trial.drive(2.0)
    assert not trial.simulation.truck.model.opt.wind.any()


def test_a_leak_empties_a_reservoir_until_it_is_repaired(trial):
    def pressure():
        return trial.simulation.truck.report().reservoir_pressure_front

    full = pressure()
    trial.events.trigger("Front brakes lose air")
    trial.drive(2.0)
    empty = pressure()
    assert empty < 0.2 * full
    trial.events.trigger("Repair the truck")
    trial.drive(3.0)
    assert pressure() > empty


def test_events_of_the_traffic_need_traffic():
    config = DriveConfig(traffic_mode="none", speed_planner="cruise")
    with Simulation(config, visuals=False) as simulation:
        names = Events(simulation).names
        with pytest.raises(InputError, match="use one of"):
            Events(simulation).trigger("Leader brakes hard")
    assert "Gust from the left" in names
    assert "Slow truck ahead" not in names
