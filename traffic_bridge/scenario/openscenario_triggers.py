"""The triggers and conditions of OpenSCENARIO files."""

from __future__ import annotations

import itertools
import math
from collections.abc import Mapping

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
        tag = node.tag
        if tag in ("SpeedCondition", "AccelerationCondition"):
            if node.get("direction", "longitudinal") != "longitudinal":
                node.fail(f"direction {node.get('direction')!r} is not read")
            measure = "speed" if tag == "SpeedCondition" else "acceleration"
            return {"measure": measure, "of": of} | _limit(node)
        if tag == "RelativeSpeedCondition":
            bodies = {"of": self._entities.body(node), "to": of}
            return {"measure": "speed_difference", **bodies, **_limit(node)}
        if tag == "TraveledDistanceCondition":
            name = self._entities.ego if of == TRUCK else of
            spot = self._entities.spot(name)
            if spot.along is not None or math.isnan(spot.offset):
                node.fail("the traveled distance of an entity off the truck's route is not read")
            front = spot.station + self._entities.members[name].front
            return {"measure": "station", "of": of, "above": front + node.number("value")}
        if tag == "StandStillCondition":
            return {"measure": "speed", "of": of, "below": REST, "lasting": node.number("duration")}
        if tag == "CollisionCondition":
            to = self._entities.body(node.only("EntityRef").first())
            return {"measure": "clearance", "of": of, "to": to, "below": TOUCH}
        if tag in ("ReachPositionCondition", "DistanceCondition"):
            return self._by_position(node, of)
        values: Values = {"of": of, "freespace": node.flag("freespace")}
        kind = node.get("relativeDistanceType", "longitudinal")
        if tag == "RelativeDistanceCondition" and kind in PLANE:
            if values.pop("freespace"):
                node.fail(f"{kind} with freespace is not read")
            to = self._entities.body(node)
            return {**values, "measure": "distance", "to": to, **_limit(node)}
        measures = {
            "TimeHeadwayCondition": "time_gap",
            "TimeToCollisionCondition": "ttc",
            "RelativeDistanceCondition": "gap",
        }
        if tag not in measures:
            node.refuse()
        if kind != "longitudinal":
            node.fail(f"relativeDistanceType {kind!r} is not read")
        other = node
        if tag == "TimeToCollisionCondition":
            other = node.child("TimeToCollisionConditionTarget").first()
            if other.tag != "EntityRef":
                other.refuse()
        to = self._entities.body(other)
        if not values["freespace"]:
            # Between the reference points.
            values["shift"] = self._entities.front(of) - self._entities.front(to)
        return {**values, "measure": measures[tag], "to": to, **_limit(node)}

    def _by_position(self, node: Node, of: str) -> Values:
        """A condition on the distance of an entity to a position."""
        position = node.child("Position").first()
        front = self._entities.front(of)
        kind = node.get("relativeDistanceType", "euclidianDistance")
        if node.tag == "ReachPositionCondition" or kind in PLANE:
            if node.flag("freespace"):
                node.fail("freespace to a position is not read")
            if position.has("entityRef"):
                if any(position.number(name, 0.0) for name in ("dx", "dy", "ds", "dLane", "dt")):
                    position.fail("a place that moves with an entity is read where the entity is")
                to = self._entities.body(position)
                limit = (
                    {"below": node.number("tolerance")} if node.has("tolerance") else _limit(node)
                )
                return {"measure": "distance", "of": of, "to": to, **limit}
            pose = self._entities.places.pose(position)
            limits = (
                {"below": node.number("tolerance")}
                if node.tag == "ReachPositionCondition"
                else _limit(node)
            )
            point = (pose.x, pose.y)
            return {"measure": "distance", "of": of, "point": point, "back": front, **limits}
        if kind == "lateral" and node.get("coordinateSystem", "entity") in ("road", "lane"):
            return {"of": of, **self._aside(node, position)}
        if kind != "longitudinal" or node.flag("freespace"):
            node.fail(f"relativeDistanceType {kind!r}, or freespace, to a position is not read")
        limit = _limit(node)
        if "below" not in limit:
            node.fail("rule must be lessThan or lessOrEqual")
        at = self._entities.station(position, self._entities.route) + front
        bounds = {"above": at - limit["below"], "below": at + limit["below"]}
        return {"measure": "station", "of": of, **bounds}

    def _aside(self, node: Node, position: Node) -> Values:
        """The offsets of an entity's center that are near to a position's."""
        found, limit = on(self._entities.route, self._entities.places.pose(position)), _limit(node)
        if found is None or "below" not in limit or node.flag("freespace"):
            node.fail("is read with lessThan, without freespace, and on the truck's route")
        bounds = found.offset - limit["below"], found.offset + limit["below"]
        return {"measure": "offset", "above": bounds[0], "below": bounds[1]}


def is_criterion(condition: Node) -> bool:
    """Returns whether a condition is a criterion of a test, which never stops a drive."""
    return condition.declared.startswith(CRITERION)


def _limit(node: Node) -> Values:
    rule = node.get("rule")
    if rule not in LIMITS:
        node.fail(f"rule {rule!r} is not read: {', '.join(LIMITS)}")
    return {LIMITS[rule]: node.number("value")}
