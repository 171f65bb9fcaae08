"""The triggers and conditions of OpenSCENARIO files."""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Mapping

from iits_mj.core.checks import did_you_mean
from traffic_bridge.scenario.actors import REST
from traffic_bridge.scenario.conditions import SIGNAL, TRUCK
from traffic_bridge.scenario.openscenario_actions import AnyGroups
from traffic_bridge.scenario.openscenario_entities import Entities, Values, on
from traffic_bridge.scenario.openscenario_file import Node

LIMITS = {
    "greaterThan": "above",
    "greaterOrEqual": "above",
    "lessThan": "below",
    "lessOrEqual": "below",
    "equalTo": "equals",
}
EDGES = {"none": "none", "rising": "rising", "falling": "falling", "risingOrFalling": "either"}
STATES = {"startTransition": "begun", "endTransition": "ended", "completeState": "ended"}
TOUCH = 1e-3  # [m] of clearance: nearer bodies touch
INSTANT = 1e-6  # [s] after a time that a condition excludes
NEVER: Values = {"measure": "time", "below": -1.0}
CRITERION = "criteria_"  # begins the names of conditions that CARLA's ScenarioRunner reads as tests
PLANE = ("cartesianDistance", "euclidianDistance")


class Triggers:
    """Makes groups of conditions of triggers.

    Args:
      entities: of the file.
      declared: its parameters and variables by name.

    Attributes:
      elements: names of the events that belong to an element of the storyboard, by its kind and
        name.
      families: numbers of the maneuvers of the events; family: of the maneuver that is read, whose
        elements are meant first by the conditions in it.
      variables: declarations of the parameters and variables that conditions compare.
    """

    def __init__(self, entities: Entities, declared: Mapping[str, Node]) -> None:
        self._entities, self._declared = entities, declared
        self.elements: dict[tuple[str, str], list[str]] = {}
        self.families: dict[str, int] = {}
        self.family = -1
        self.variables: dict[str, Node] = {}

    def groups(self, trigger: Node, stop: bool = False) -> AnyGroups:
        """Returns the groups of a trigger; a stop leaves out collisions, which end every drive."""
        groups: AnyGroups = []
        for group in trigger.only("ConditionGroup"):
            parts = list(group.only("Condition"))
            if stop and any(self._is_collision(part) for part in parts):
                continue
            for chosen in itertools.product(*(self._condition(part) for part in parts)):
                groups.append([condition for each in chosen for condition in each])
        return groups

    def _is_collision(self, condition: Node) -> bool:
        found = condition.find("ByEntityCondition")
        if found is None or found.child("EntityCondition").find("CollisionCondition") is None:
            return False
        names = [each.get("entityRef") for each in found.child("TriggeringEntities")]
        return self._entities.ego in names

    def _condition(self, node: Node) -> AnyGroups:
        edge = node.get("conditionEdge", "none")
        if edge not in EDGES:
            node.fail(f"conditionEdge {edge!r}: allowed are {', '.join(EDGES)}")
        base: Values = {"edge": EDGES[edge], "delay": node.number("delay", 0.0)}
        kind = node.first()
        if is_criterion(node):
            return [[base | NEVER]]
        if kind.tag == "ByValueCondition":
            return self._by_value(kind.first(), base)
        triggering = kind.child("TriggeringEntities")
        entities = [
            TRUCK if name == self._entities.ego else name
            for each in triggering.only("EntityRef")
            for name in self._entities.several(each)
        ]
        if len(entities) > 1 and edge != "none":
            triggering.fail(f"several entities with conditionEdge {edge!r} are not read")
        condition = kind.child("EntityCondition").first()
        made = [base | self._by_entity(condition, name) for name in entities]
        every = triggering.get("triggeringEntitiesRule") == "all"
        return [made] if every else [[each] for each in made]

    def _by_value(self, node: Node, base: Values) -> AnyGroups:
        if node.tag == "SimulationTimeCondition":
            # The event's comparison is inclusive.
            shift = {"greaterThan": INSTANT, "lessThan": -INSTANT}.get(node.get("rule"), 0.0)
            values = {name: value + shift for name, value in _limit(node).items()}
            return [[base | {"measure": "time"} | values]]
        references = {
            "ParameterCondition": "parameterRef",
            "VariableCondition": "variableRef",
            "TrafficSignalCondition": "name",
        }
        if node.tag in references:
            name = node.get(references[node.tag])
            if node.tag == "TrafficSignalCondition":
                return [[base | {"variable": f"{SIGNAL}{name}", "text": node.get("state")}]]
            self._declare(node, name)
            if isinstance(node.value("value"), str):
                if node.get("rule") != "equalTo":
                    node.fail("a text is compared with the rule equalTo")
                return [[base | {"variable": name, "text": node.get("value")}]]
            return [[base | {"variable": name} | _limit(node)]]
        if node.tag != "StoryboardElementStateCondition":
            node.refuse()
        if self.is_replaced(node):
            return [[base | NEVER]]
        state, kind = node.get("state"), node.get("storyboardElementType")
        if state not in STATES:
            node.fail(f"state {state!r} is not read: {', '.join(STATES)}")
        reached, name = STATES[state], node.get("storyboardElementRef").rpartition("::")[2]
        found = self.elements.get((kind, name))
        if (kind, reached) == ("act", "begun"):
            found = self.elements.get(("act start", name))
        if not found:
            node.fail(f"there is no {kind} {name!r} with events of the traffic")
        # Elements of the same maneuver are meant before others of the same name.
        found = [each for each in found if self.families.get(each) == self.family] or found
        if len(found) > 1:
            base = base | {"edge": "none"}
        made = [base | {"event": each, "state": reached} for each in found]
        return [made] if reached == "ended" else [[each] for each in made]

    def is_replaced(self, node: Node) -> bool:
        """Returns whether a condition waits for an event of the ego that its driver replaces."""
        kind, name = node.get("storyboardElementType"), node.get("storyboardElementRef")
        key = kind, name.rpartition("::")[2]
        return self.elements.get(key) == []

    def _declare(self, node: Node, name: str) -> None:
        """Lets a parameter or a variable begin with its declared value."""
        if name not in self._declared:
            node.fail(f"{name} is not declared{did_you_mean(name, self._declared)}")
        self.variables[name] = self._declared[name]

    def _by_entity(self, node: Node, of: str) -> Values:
        if node.tag not in BY_ENTITY:
            node.refuse()
        return {"of": of, **BY_ENTITY[node.tag](self, node, of)}

    def _of_one(self, node: Node, of: str) -> Values:
        """A condition on the speed or the acceleration of an entity."""
        del of
        if node.get("direction", "longitudinal") != "longitudinal":
            node.fail(f"direction {node.get('direction')!r} is not read")
        return {"measure": MEASURES[node.tag], **_limit(node)}

    def _relative_speed(self, node: Node, of: str) -> Values:
        bodies = {"of": self._entities.body(node), "to": of}
        return {"measure": "speed_difference", **bodies, **_limit(node)}

    def _traveled(self, node: Node, of: str) -> Values:
        name = self._entities.ego if of == TRUCK else of
        spot = self._entities.spot(name)
        if spot.along is not None or math.isnan(spot.offset):
            node.fail("the traveled distance of an entity off the truck's route is not read")
        front = spot.station + self._entities.front(name)
        return {"measure": "station", "above": front + node.number("value")}

    def _collision(self, node: Node, of: str) -> Values:
        del of
        to = self._entities.body(node.only("EntityRef").first())
        return {"measure": "clearance", "to": to, "below": TOUCH}

    def _distance(self, node: Node, of: str) -> Values:
        """A condition on a gap of two entities, in meters or seconds."""
        freespace, other = node.flag("freespace"), node
        kind = node.get("relativeDistanceType", "longitudinal")
        if node.tag == "RelativeDistanceCondition" and kind in PLANE:
            if freespace:
                node.fail(f"{kind} with freespace is not read")
            return {"measure": "distance", "to": self._entities.body(node), **_limit(node)}
        if kind != "longitudinal":
            node.fail(f"relativeDistanceType {kind!r} is not read")
        if node.tag == "TimeToCollisionCondition":
            other = node.child("TimeToCollisionConditionTarget").only("EntityRef").first()
        to = self._entities.body(other)
        # Without freespace it is between the reference points.
        shift = 0.0 if freespace else self._entities.front(of) - self._entities.front(to)
        found = {"measure": MEASURES[node.tag], "freespace": freespace, "shift": shift}
        return {**found, "to": to, **_limit(node)}

    def _by_position(self, node: Node, of: str) -> Values:
        """A condition on the distance of an entity to a position."""
        position = node.child("Position").first()
        front = self._entities.front(of)
        reached = node.tag == "ReachPositionCondition"
        kind = node.get("relativeDistanceType", PLANE[0])
        limit = {"below": node.number("tolerance")} if reached else _limit(node)
        if (reached or kind in PLANE or kind == "longitudinal") and node.flag("freespace"):
            node.fail("freespace to a position is not read")
        if (reached or kind in PLANE) and position.has("entityRef"):
            if any(position.number(name, 0.0) for name in ("dx", "dy", "ds", "dLane", "dt")):
                position.fail("a place that moves with an entity is read where the entity is")
            return {"measure": "distance", "to": self._entities.body(position), **limit}
        if reached or kind in PLANE:
            pose = self._entities.places.pose(position)
            return {"measure": "distance", "point": (pose.x, pose.y), "back": front, **limit}
        if kind == "lateral" and node.get("coordinateSystem", "entity") in ("road", "lane"):
            return self._aside(node, position)
        if kind != "longitudinal":
            node.fail(f"relativeDistanceType {kind!r} to a position is not read")
        if "below" not in limit:
            node.fail("rule must be lessThan or lessOrEqual")
        at = self._entities.station(position, self._entities.route) + front
        return {"measure": "station", "above": at - limit["below"], "below": at + limit["below"]}

    def _aside(self, node: Node, position: Node) -> Values:
        """The offsets of an entity's center that are near to a position's."""
        found, limit = on(self._entities.route, self._entities.places.pose(position)), _limit(node)
        if found is None or "below" not in limit or node.flag("freespace"):
            node.fail("is read with lessThan, without freespace, and on the truck's route")
        bounds = found.offset - limit["below"], found.offset + limit["below"]
        return {"measure": "offset", "above": bounds[0], "below": bounds[1]}


MEASURES = {
    "SpeedCondition": "speed",
    "AccelerationCondition": "acceleration",
    "TimeHeadwayCondition": "time_gap",
    "TimeToCollisionCondition": "ttc",
    "RelativeDistanceCondition": "gap",
}
BY_ENTITY: dict[str, Callable[[Triggers, Node, str], Values]] = {
    **dict.fromkeys(("SpeedCondition", "AccelerationCondition"), Triggers._of_one),
    **dict.fromkeys(list(MEASURES)[2:], Triggers._distance),
    **dict.fromkeys(("ReachPositionCondition", "DistanceCondition"), Triggers._by_position),
    "RelativeSpeedCondition": Triggers._relative_speed,
    "TraveledDistanceCondition": Triggers._traveled,
    "CollisionCondition": Triggers._collision,
    "StandStillCondition": lambda _, node, __: {
        "measure": "speed",
        "below": REST,
        "lasting": node.number("duration"),
    },
}


def is_criterion(condition: Node) -> bool:
    """Returns whether a condition is a criterion of a test, which never stops a drive."""
    return condition.declared.startswith(CRITERION)


def _limit(node: Node) -> Values:
    rule = node.get("rule")
    if rule not in LIMITS:
        node.fail(f"rule {rule!r} is not read: {', '.join(LIMITS)}")
    return {LIMITS[rule]: node.number("value")}
