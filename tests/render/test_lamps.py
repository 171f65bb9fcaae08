"""The lamps of traffic lights show the states that the driver sees."""

from types import SimpleNamespace

import mujoco
import numpy as np
import pytest

from iits_mj.core.messages import LightState, RoadSignals, SignalLamp, TrafficLight
from iits_mj.model.scenery.road_scene import add_road
from iits_mj.model.scenery.signs import lamp_of
from iits_mj.render.lamps import Lamps, RoadLights
from iits_mj.road import RoadMap
from iits_mj.road.opendrive import parse
from tests.road.opendrive_text import document, road

LIGHT = '<signal id="{}" s="{}" t="-5" dynamic="yes" type="{}" zOffset="2.4" orientation="{}"/>'
PLACES = [(1, 40, "1000001", "+"), (2, 50, "1000001", "-"), (3, 55, "1000002", "+")]


@pytest.fixture(scope="module")
def lamps():
    text = document(
        road(extra=f"<signals>{''.join(LIGHT.format(*place) for place in PLACES)}</signals>")
    )
    spec = mujoco.MjSpec()
    tractor = spec.worldbody.add_body(name="tractor")
    tractor.add_geom(size=[0.1, 0.1, 0.1])
    add_road(spec, RoadMap(parse(text.encode(), "map"), "map").route())
    model = spec.compile()
    return Lamps(model), model


def frame(time, light, shown=()):
    ego = SimpleNamespace(brake_pressures=(0.0,), acceleration=0.0, speed=5.0)
    signals = RoadSignals(light, lamps=tuple(SignalLamp(*one) for one in shown))
    scene = SimpleNamespace(signals=signals, vehicles=(), time=time)
    return SimpleNamespace(time=time, ego=ego, trajectory=None, scene=scene)


def lit(lamps, time, state, station=38.0, shown=()):
    """Materials of the lamps that are lit."""
    made, model = lamps
    light = None if state is None else TrafficLight(station, state, None, None)
    data = mujoco.MjData(model)
    bright = made.brightness(made.signals(data, frame(time, light, shown)), time, on=False)
    return [
        lamp_of(model.geom(geom).name).material
        for geom, value in zip(made.geom.tolist(), bright, strict=True)
        if value > 1.0
    ]


@pytest.mark.parametrize(
    ("state", "color"),
    [
        (LightState.RED, "red"),
        (LightState.STOP, "red"),
        (LightState.YELLOW, "yellow"),
        (LightState.GREEN, "green"),
    ],
)
def test_one_lamp_of_the_light_that_faces_the_truck_is_lit(lamps, state, color):
    assert lit(lamps, 1.0, state) == [f"road_lamp_{color}"]


def test_light_of_another_stop_line_is_dark(lamps):
    assert lit(lamps, 500.0, LightState.RED, station=90.0) == []
    assert lit(lamps, 501.0, None) == []


def test_light_that_was_passed_keeps_its_state_for_a_while(lamps):
    assert lit(lamps, 100.0, LightState.GREEN) == ["road_lamp_green"]
    assert lit(lamps, 110.0, None) == ["road_lamp_green"]
    assert lit(lamps, 130.0, None) == []


def test_each_signal_of_the_map_shows_its_own_state(lamps):
    made, model = lamps
    shown = [("1", LightState.RED), ("2", LightState.YELLOW), ("3", LightState.GREEN)]
    light = TrafficLight(38.0, LightState.RED, None, None)
    signals = made.signals(mujoco.MjData(model), frame(250.0, light, shown))
    bright = made.brightness(signals, 250.0, on=False)
    found = {
        (lamp.signal, lamp.material.removeprefix("road_lamp_"))
        for geom, value in zip(made.geom.tolist(), bright, strict=True)
        if value > 1.0 and (lamp := lamp_of(model.geom(geom).name))
    }
    assert found == {("1", "red"), ("2", "yellow"), ("3", "green")}
    # A light that is switched off is dark, also at the next stop line.
    assert lit(lamps, 250.0, LightState.RED, shown=shown[1:2]) == ["road_lamp_yellow"]


def test_lit_lamp_shines_against_the_direction_of_travel(lamps):
    made, model = lamps
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    light = TrafficLight(38.0, LightState.RED, None, None)
    bright = made.brightness(made.signals(data, frame(200.0, light)), 200.0, on=False)
    places = np.concatenate([data.geom_xmat.reshape(-1, 3, 3), data.geom_xpos[:, :, None]], axis=2)
    shown = made.lights(places, bright)
    np.testing.assert_allclose(shown.forward, [[-1.0, 0.0, 0.0]], atol=0.01)
    np.testing.assert_allclose(shown.at[:, :2], [[39.7, -5.0]], atol=0.1)


def test_web_pages_light_the_same_lamps(lamps):
    _, model = lamps
    lights = RoadLights(model)
    # Two lights with three lamps, one with two.
    assert len(lights.lamps) == 8
    for state, color in ((LightState.RED, "red"), (LightState.GREEN, "green")):
        (geom,) = lights.lit(RoadSignals(TrafficLight(38.0, state, None, None)), 1.0)
        assert (lights.lamps[geom].material, lights.lamps[geom].station) == (
            f"road_lamp_{color}",
            40.0,
        )
    assert lights.lit(RoadSignals(), 60.0) == set()
