import pytest

from iits_mj.core.errors import InputError
from iits_mj.road import RoadMap
from tests.paths import outside
from traffic_bridge import PureSim, TrafficConfig


def test_vehicles_stop_at_a_red_light_and_drive_at_green():
    path = outside("xodr/esmini_fabriksgatan_traffic_lights.xodr")
    route = RoadMap.from_opendrive(path).route()
    with PureSim(route, TrafficConfig(density=0.2, speed_limit=10.0), seed=1) as traffic:
        traffic.reset()
        lights = traffic.signals.lights()
        assert lights
        for light in lights:
            traffic.signals.set_state(light, "r")
        for _ in range(400):
            vehicles = traffic.step()
        waiting = [v for v in vehicles if v.speed < 0.1]
        assert waiting
        front = max(v.station for v in waiting)
        for light in lights:
            traffic.signals.set_state(light, "G")
        for _ in range(150):
            vehicles = traffic.step()
        moved = {v.id: v for v in vehicles}
        first = max(waiting, key=lambda v: v.station)
        assert first.id not in moved or moved[first.id].station > front + 20.0
        with pytest.raises(InputError, match="letters of"):
            traffic.signals.set_state(lights[0], "xy")


def test_a_lower_speed_limit_slows_the_traffic_until_it_is_removed(straight):
    with PureSim(straight, TrafficConfig(density=0.1), seed=1) as traffic:
        traffic.reset()
        traffic.signals.set_speed_limit(5.0)
        for _ in range(200):
            vehicles = traffic.step()
        assert max(v.speed for v in vehicles) < 5.1
        traffic.signals.reset_speed_limits()
        for _ in range(300):
            vehicles = traffic.step()
        assert max(v.speed for v in vehicles) > 10.0
        with pytest.raises(InputError, match="1 to 70"):
            traffic.signals.set_speed_limit(float("nan"))


def test_a_closed_lane_is_empty_until_it_is_opened(straight):
    config = TrafficConfig(density=0.1, fill_ahead=4000.0)
    with PureSim(straight, config, seed=1) as traffic:
        traffic.reset()
        closure = traffic.signals.close_lane(1, 3000.0, 3120.0)
        for _ in range(600):
            vehicles = traffic.step()
            inside = [
                v for v in vehicles if v.lane == 1 and 3012.0 < v.station < 3080.0 and v.speed > 0.5
            ]
            if traffic.time > 30.0:
                assert not inside
        standing = [v for v in vehicles if v.id.startswith("blocker")]
        assert len(standing) == 2
        assert {v.kind for v in standing} == {"truck"}
        traffic.signals.open_lane(closure)
        assert not any(v.id.startswith("blocker") for v in traffic.step())
        with pytest.raises(InputError, match="does not exist"):
            traffic.signals.close_lane(7, 100.0, 200.0)


def test_unknown_lights_are_named(straight):
    with PureSim(straight, TrafficConfig(density="empty")) as traffic:
        traffic.reset()
        with pytest.raises(InputError, match="no traffic light 'x'"):
            traffic.signals.state("x")
