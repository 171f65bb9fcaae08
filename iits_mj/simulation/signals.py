"""What the traffic's lights and signs say to the truck, as messages."""

from __future__ import annotations

from iits_mj.messages import (
    EgoFootprint,
    EgoState,
    LightState,
    RoadSignals,
    SpeedZone,
    TrafficLight,
)
from iits_mj.road import Route
from traffic_bridge import LightAhead, PureSim, Recorder, Traffic

# A changed limit further ahead than this is not seen yet [m].
SIGHT = 500.0
# Stop lines of the lanes of one crossing lie within this [m].
SAME_LINE = 15.0
# A line is told of until the front bumper is this far behind it: who stops on it must still see it;
# more than what the truck drives in a cycle [m].
BEHIND = 4.0


def read_signals(
    traffic: Traffic | None, ego: EgoState, route: Route, footprint: EgoFootprint
) -> RoadSignals:
    """The next light, or the one that the front is just over, and the limits set near the truck.

    Only traffic that SUMO runs has any: a PureSim, which InterSim and MixedSim are, also inside a
    recorder.

    Args:
      traffic: that runs, None for an empty road.
      ego: the truck.
      route: its road.
      footprint: its size.
    """
    if isinstance(traffic, Recorder):
        traffic = traffic.traffic
    if not isinstance(traffic, PureSim):
        return RoadSignals()
    signals = traffic.signals
    front = ego.station + footprint.front_overhang
    light = signals.light_ahead(front - BEHIND)
    lane = int(route.lane_at(ego.station, ego.offset))
    own = signals.light_ahead(front - BEHIND, lane) if light is not None and lane >= 0 else None
    # Lanes may be numbered otherwise at the line: a line is never driven over for that.
    if own is not None and light is not None and own.station < light.station + SAME_LINE:
        light = own
    zones = tuple(
        SpeedZone(rule.start, rule.end, rule.limit, rule.lane)
        for rule in signals.limits.rules
        if rule.end > ego.station - SIGHT and rule.start < ego.station + SIGHT
    )
    return RoadSignals(None if light is None else _light(light), zones)


def _light(light: LightAhead) -> TrafficLight:
    following = None if light.next_letter is None else _state(light.next_letter)
    return TrafficLight(light.station, _state(light.letter), light.next_switch, following)


def _state(letter: str) -> LightState:
    """Of a SUMO letter: "o" and "O" are off; "u" is red with yellow; "s" is a green arrow."""
    if letter in "gGoO":
        return LightState.GREEN
    if letter == "s":
        return LightState.STOP
    return LightState.YELLOW if letter in "yY" else LightState.RED
