import math

import pytest

from iits_mj.core.errors import InputError
from iits_mj.road import Route
from traffic_bridge import PureSim, TrafficConfig


@pytest.fixture(scope="module")
def road():
    return Route.straight(length=2000.0)


@pytest.mark.parametrize("model", ["lc2013", "mobil"])
def test_a_limit_inside_a_sumo_lane_holds_from_its_station_to_its_end(model, road):
    start, end = 803.0, 1117.0
    config = TrafficConfig(density=0.08, lane_change=model)
    before, at_start, past, hardest = {}, [], [], 0.0
    with PureSim(road, config, seed=3) as traffic:
        traffic.reset()
        traffic.signals.set_speed_limit(8.0, start, end)
        for _ in range(900):
            frame = traffic.step()
            fronts = frame.column("station") + 0.5 * frame.column("length")
            speeds, slowing = frame.column("speed"), frame.column("acceleration")
            if traffic.time < 40.0:
                continue
            inside = (fronts > start) & (fronts < end)
            assert speeds[inside].max(initial=0.0) < 8.0 + 1e-6
            hardest = min(hardest, slowing[(fronts > 500.0) & (fronts < start)].min(initial=0.0))
            for name, front, speed in zip(frame.ids, fronts, speeds, strict=True):
                was = before.get(name, math.inf)
                if was < start <= front:
                    at_start.append(speed)
                if front > end + 150.0:
                    past.append(speed)
            before = dict(zip(frame.ids, fronts, strict=True))
    # Vehicles reach the sign at the limit with moderate braking, and accelerate after the end.
    assert len(at_start) > 5
    assert max(at_start) == pytest.approx(8.0, abs=0.01)
    assert hardest > -4.0
    assert max(past) > 11.0


def test_a_new_limit_slows_the_vehicles_on_its_stretch_with_comfortable_braking(road):
    with PureSim(road, TrafficConfig(density=0.1), seed=2) as traffic:
        traffic.reset()
        for _ in range(50):
            traffic.step()
        traffic.signals.set_speed_limit(6.0, 500.0, 1500.0)
        hardest = 0.0
        for _ in range(200):
            frame = traffic.step()
            hardest = min(hardest, frame.column("acceleration").min())
        inside = (frame.column("station") > 510.0) & (frame.column("station") < 1490.0)
        assert inside.sum() > 10
        assert frame.column("speed")[inside].max() < 6.0 + 1e-6
    # Three quarters of the comfortable 2 m/s2, and more behind another braking vehicle.
    assert -2.5 < hardest < -1.4


def test_a_limit_on_one_lane_does_not_affect_the_others_and_the_later_limit_holds(road):
    with PureSim(road, TrafficConfig(density=0.1), seed=1) as traffic:
        traffic.reset()
        signals = traffic.signals
        first = signals.set_speed_limit(10.0, 500.0, 1500.0, lane=0)
        second = signals.set_speed_limit(6.0, 900.0, 1100.0)
        found = [signals.speed_limit(s, lane) for lane in (0, 1) for s in (400.0, 600.0, 1000.0)]
        assert found == [25.0, 10.0, 6.0, 25.0, 25.0, 6.0]
        signals.lift_speed_limit(second)
        assert signals.speed_limit(1000.0, 0) == 10.0
        assert signals.speed_limit(1000.0, 1) == 25.0
        for _ in range(400):
            vehicles = traffic.step()
        right = [v.speed for v in vehicles if v.lane == 0 and 520.0 < v.station < 1480.0]
        middle = [v.speed for v in vehicles if v.lane == 1 and 520.0 < v.station < 1480.0]
        assert max(right) < 10.0 + 1e-6
        assert max(middle) > 12.0
        signals.lift_speed_limit(first)
        for _ in range(150):
            vehicles = traffic.step()
        assert max(v.speed for v in vehicles if v.lane == 0 and 520.0 < v.station < 1480.0) > 12.0


def test_a_limit_above_the_maps_lets_vehicles_drive_faster():
    slow = Route.straight(length=1500.0, speed_limit=8.0)
    with PureSim(slow, TrafficConfig(density=0.05, speed_limit=15.0), seed=1) as traffic:
        traffic.reset()
        traffic.signals.set_speed_limit(20.0, 600.0)
        for _ in range(500):
            vehicles = traffic.step()
        # Speeds are of the front bumper, which passes a sign first.
        assert max(v.speed for v in vehicles if v.station < 590.0) < 8.0 + 1e-6
        assert max(v.speed for v in vehicles if v.station > 800.0) > 12.0


def test_a_vehicle_keeps_its_desired_speed_under_a_limit(road):
    with PureSim(road, TrafficConfig(density=0.05), seed=1) as traffic:
        traffic.reset()
        number = traffic.signals.set_speed_limit(5.0, 100.5, 1899.5)
        for _ in range(100):
            vehicles = traffic.step()
        name = next(v.id for v in vehicles if 500.0 < v.station < 1000.0)
        desired = traffic.vehicles.desired_speed(name)
        assert desired > 9.0
        assert traffic.vehicles.present_speed(name) == 5.0
        assert traffic.vehicles.in_force(name)["desired_speed"] == 5.0
        traffic.vehicles.change(name, desired_speed=11.0)
        assert traffic.vehicles.in_force(name)["desired_speed"] == 5.0
        traffic.signals.lift_speed_limit(number)
        traffic.step()
        assert traffic.vehicles.in_force(name)["desired_speed"] == 11.0


def test_impossible_limits_are_refused_with_what_is_allowed(road):
    with PureSim(road, TrafficConfig(density="empty")) as traffic:
        traffic.reset()
        signals = traffic.signals
        for arguments, text in [
            ((math.nan,), "1 to 70"),
            ((0.0,), "1 to 70"),
            ((9.0, 50.0, 20.0), "start = 50 m must be before end = 20 m"),
            ((9.0, math.nan, 20.0), "start = nan"),
            (("fast",), "limit = 'fast'"),
            ((9.0, 0.0, 20.0, 8), "no lane 8"),
            ((9.0, 5000.0, 6000.0), "no lane of the route"),
            ((9.0, 0.0, 20.0, "left"), "lane = 'left'"),
        ]:
            with pytest.raises(InputError, match=text):
                signals.set_speed_limit(*arguments)
        with pytest.raises(InputError, match=r"speed limit 7: there are \[\]"):
            signals.lift_speed_limit(7)
        with pytest.raises(InputError, match="does not exist at station nan"):
            signals.speed_limit(math.nan)
