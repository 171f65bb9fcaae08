"""Reads ASAM OpenSCENARIO XML 1.0 to 1.3: the start of the truck, and the events of the traffic.

Element and attribute names are those of the standard. Everything that is not read is refused with
its element, file and line. Not used are controllers other than that of the Intelligent Driver
Model, colors, time of day and weather other than wind, and the actions of the ego: it is the truck,
and its own driver decides.
"""

from __future__ import annotations

import dataclasses
import itertools
from collections.abc import Container, Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import NamedTuple

from iits_mj.core.messages import EgoFootprint
from iits_mj.road import Route
from traffic_bridge.scenario.actions import ChangeSpeed, KeepDistance
from traffic_bridge.scenario.conditions import ROLES, TRUCK
from traffic_bridge.scenario.openscenario_actions import (
    Actions,
    AnyGroups,
    activation,
    own_values,
    scenario_event,
)
from traffic_bridge.scenario.openscenario_entities import UNUSED, Entities, Values
from traffic_bridge.scenario.openscenario_file import Node, number_or_text, read_root
from traffic_bridge.scenario.openscenario_parameters import parameters_of
from traffic_bridge.scenario.openscenario_triggers import Triggers, is_criterion
from traffic_bridge.scenario.parameters import scope_of
from traffic_bridge.scenario.reading import event_of
from traffic_bridge.signals.events import Event

STOPPED = "{} has stopped"  # the variable of an act that has a stop trigger
PRIORITIES = ("overwrite", "override", "parallel")


class Start(NamedTuple):
    """Start of the truck: station of its steer axle [m], lane from the outside, speed [m/s]."""

    station: float
    lane: int
    speed: float


class _Step(NamedTuple):
    """An action of an event for one actor, with the name of the event that is made of it."""

    name: str
    action: Node
    actor: str
    event: Node
    act: str
    family: int


def read_scenario(
    path: str | Path, ego: str | None = None, given: Mapping[str, str] | None = None
) -> OpenScenario:
    """Reads a scenario.

    Args:
      path: of the .xosc file.
      ego: name of the entity that is the truck; None: the first one named Ego or Hero.
      given: values of the file's parameters, as text by name; the others are as declared.

    Raises:
      InputError: the file cannot be read, the entity is not in it, a value is not allowed, or an
        element is not supported.
    """
    return OpenScenario(read_root(Path(path)), ego, given or {})


class OpenScenario:
    """A scenario; use `read_scenario`.

    Attributes:
      map: OpenDRIVE file.
      ego: name of the entity that is the truck.
      notes: what the truck's own driver replaces, in words.
    """

    def __init__(self, root: Node, ego: str | None, given: Mapping[str, str]) -> None:
        header = root.child("FileHeader")
        version = header.get("revMajor"), header.get("revMinor")
        if version[0] != "1" or version[1] not in ("0", "1", "2", "3"):
            header.fail(f"is OpenSCENARIO {'.'.join(version)}; versions 1.0 to 1.3 are supported")
        scope_of(parameters_of(root), given, str(root.path))
        root = root.scoped(given)
        root.only(
            *("FileHeader", "ParameterDeclarations", "VariableDeclarations", "MonitorDeclarations"),
            *("CatalogLocations", "RoadNetwork", "Entities", "Storyboard"),
        )
        network = root.child("RoadNetwork")
        network.only("LogicFile", "SceneGraphFile", "UsedArea", "TrafficSignals")
        self._has_signals = next(iter(network.find("TrafficSignals") or ()), None) is not None
        self.map = root.path.parent / network.child("LogicFile").get("filepath")
        board = root.child("Storyboard").only("Init", "Story", "StopTrigger")
        self._init = board.child("Init").child("Actions")
        self._init.only("Private", "GlobalAction", "UserDefined")
        self._board, self._stop = board, board.find("StopTrigger")
        self._entities = Entities(root, self._init, ego, self.map)
        self.ego = self._entities.ego
        groups = (root.find("ParameterDeclarations"), root.find("VariableDeclarations"))
        declared = {node.declared: node for group in groups for node in group or ()}
        self._values = root.scope
        self._triggers = Triggers(self._entities, declared)
        self._actions = Actions(self._entities, self._new_name)
        self._steps: list[_Step] = []
        self._acts: list[tuple[str, Node]] = []
        self._names: set[str] = set(self._entities.members) | set(ROLES) | {TRUCK}
        self._skipped: list[str] = []
        for story in board:
            if story.tag == "Story":
                self._read_story(story.scoped())
        self.notes = tuple(self._remarks(board))

    @property
    def files(self) -> tuple[Path, ...]:
        """The files that it uses beside its own: map and catalogs."""
        return (self.map, *self._entities.catalogs.files())

    @property
    def route(self) -> str:
        """The road of the ego, see `Entities.ego_words`."""
        return self._entities.ego_words

    def start(self, route: Route, footprint: EgoFootprint) -> Start:
        """Returns the start of the truck, whose front is that of the file's ego."""
        self._entities.use(route)
        spot = self._entities.spot(self.ego)
        station = spot.station + self._entities.front(self.ego) - footprint.front_overhang
        lane = route.lane_at(spot.station, spot.offset)
        if lane < 0:
            self._entities.start(self.ego).fail("the ego is not on a lane of its route")
        return Start(station, lane, self._entities.speed(self.ego))

    def events(self, route: Route) -> tuple[Event, ...]:
        """Returns the events of the traffic on the truck's road.

        Raises:
          InputError: an entity is not on the map, or an element is not supported.
        """
        self._entities.use(route)
        # An act that has a stop trigger, by its name: events that have not begun then never do.
        stops = {
            act: (node, groups)
            for act, node in self._acts
            if (groups := self._groups(node.find("StopTrigger"), stop=True))
        }
        made = [
            *self._of_init(),
            *self._of_acts(stops),
            *itertools.chain(*(self._of_step(step, stops) for step in self._steps)),
        ]
        self._triggers.family = -1
        if groups := self._groups(self._stop, stop=True):
            made.append(scenario_event(self._stop or self._board, {"event": "end_drive"}, groups))
        # Variables have their first values before any condition.
        return (*self._first_values(stops), *_with_final_speeds(made))

    def _groups(self, trigger: Node | None, stop: bool = False) -> AnyGroups:
        return [] if trigger is None else self._triggers.groups(trigger, stop)

    def _of_init(self) -> Iterator[Event]:
        """What is there and holds from the beginning."""
        for node in self._init:
            if node.tag == "GlobalAction" and node.find("EntityAction") is None:
                kind = node.first()
                yield from (scenario_event(*each) for each in self._actions.of_world(kind))
        away = {step.name for step in self._steps if _is_added(step.action)}
        away |= {self.ego, *self._entities.towed, *self._entities.lost}
        for name, entity in self._entities.members.items():
            if name not in away:
                yield from self._actions.placed(name, entity)

    def _of_acts(self, stops: Mapping[str, tuple[Node, AnyGroups]]) -> Iterator[Event]:
        """A milestone at the start of each act, and a variable at its end."""
        for act, node in self._acts:
            groups = self._groups(node.find("StartTrigger"))
            yield scenario_event(node, {"event": "milestone", "name": act}, groups)
            if act in stops:
                named = {"name": f"stop of {act}", "variable": STOPPED.format(act), "value": 1.0}
                yield scenario_event(stops[act][0], {"event": "set_value", **named}, stops[act][1])

    def _of_step(self, step: _Step, stops: Container[str]) -> Iterator[Event]:
        """The events of an action for one actor."""
        self._triggers.family = step.family
        running: list[Values] = [{"event": step.act, "state": "begun"}]
        if step.act in stops:
            running.append({"variable": STOPPED.format(step.act), "below": 0.5})
        own = self._groups(step.event.find("StartTrigger"))
        groups = [[*running, *group] for group in own or [[]]]
        kind = step.action.first()
        if _is_added(step.action):
            yield from self._actions.placed(step.name, self._entities.members[step.name], groups)
        elif kind.tag == "PrivateAction":
            values = self._actions.values(step.action, step.name, step.actor)
            yield scenario_event(step.event, values, groups)
        elif kind.tag == "UserDefinedAction":
            yield scenario_event(kind, {"name": step.name, **(own_values(kind) or {})}, groups)
        elif kind.tag != "GlobalAction":
            kind.refuse()
        else:
            for node, values in self._actions.of_world(kind.first(), step.name):
                yield scenario_event(node, values, groups)

    def _first_values(self, stops: Iterable[str]) -> Iterator[Event]:
        for name, node in self._triggers.variables.items():
            text = self._values[name] if node.tag == "ParameterDeclaration" else node.get("value")
            yield event_of(_set(name, number_or_text(text)))
        yield from (event_of(_set(STOPPED.format(act), 0.0)) for act in sorted(stops))

    def _remarks(self, board: Node) -> Iterator[str]:
        entities, ego = self._entities, self.ego
        waiting = [
            node.get("storyboardElementRef")
            for node in board.all("StoryboardElementStateCondition")
            if self._triggers.is_replaced(node)
        ]
        criteria = [each.declared for each in board.all("Condition") if is_criterion(each)]
        said = {
            f"the truck's own driver replaces the events of {ego}": self._skipped,
            "without effect": entities.unused,
            "without a place, and so left out": entities.lost,
            "criteria of tests never hold": criteria,
            f"conditions on these events of {ego} never hold": waiting,
        }
        for words, names in said.items():
            if names:
                yield f"{words}: {', '.join(dict.fromkeys(names))}"
        if self._has_signals:
            yield "without effect: TrafficSignals; lights keep the states that events give them"
        if ego in entities.trajectories:
            yield f"the truck's own driver replaces the trajectory of {ego}"

    def _read_story(self, story: Node) -> None:
        for act in story.only("ParameterDeclarations", "Act"):
            if act.tag != "Act":
                continue
            act.only("ManeuverGroup", "StartTrigger", "StopTrigger")
            name = self._new_name(_name(act))
            self._acts.append((name, act))
            self._triggers.elements["act start", _name(act)] = [name]
            for group in act:
                if group.tag == "ManeuverGroup":
                    self._read_group(group, (story, act, group), name)

    def _read_group(self, group: Node, parents: Sequence[Node], act: str) -> None:
        actors = group.child("Actors")
        if actors.flag("selectTriggeringEntities"):
            actors.fail("selectTriggeringEntities is not read")
        names = [n for each in actors.only("EntityRef") for n in self._entities.several(each)]
        for node in group.only("Actors", "CatalogReference", "Maneuver"):
            if node.tag == "Actors":
                continue
            maneuver = self._entities.catalogs.resolve(node)
            family = len(self._steps)
            for event in maneuver.only("ParameterDeclarations", "Event"):
                if event.tag != "Event":
                    continue
                if set(names) != {self.ego}:
                    _once(group)
                    _once(event)
                event.only("Action", "StartTrigger")
                if event.get("priority") not in PRIORITIES:
                    event.fail(f"priority must be one of {', '.join(PRIORITIES)}")
                first = len(self._steps)
                for action, actor in self._acting(event, names):
                    self._read_step(action, actor, event, act, family)
                made = [step.name for step in self._steps[first:]]
                for each in (*parents, maneuver, event):
                    kind = each.tag[:1].lower() + each.tag[1:]
                    self._triggers.elements.setdefault((kind, _name(each)), []).extend(made)

    def _acting(self, event: Node, names: Sequence[str]) -> Iterator[tuple[Node, str]]:
        """The actions of an event with an effect here, for each actor, "" for one of the world."""
        added = [a.get("entityRef") for a in event.all("EntityAction") if _is_added(a)]
        for action in event:
            kind = next(iter(action), None)
            if action.tag != "Action" or kind is None:
                continue
            if kind.tag == "UserDefinedAction" and own_values(kind) is None:
                self._entities.not_used(kind.child("CustomCommandAction"), _name(event))
                continue
            for actor in names if kind.tag == "PrivateAction" else ("",):
                if actor == self.ego:
                    self._skipped.append(_name(event))
                    self._triggers.elements.setdefault(("action", _name(action)), [])
                # An added entity may have its speed at once.
                elif actor not in added or not self._entities.starts_with(kind, actor):
                    yield action, actor

    def _read_step(self, action: Node, actor: str, event: Node, act: str, family: int) -> None:
        does = next(iter(action.first()), action)
        reactive = actor and self._entities.members[actor].reactive
        if does.tag in UNUSED and not (reactive and activation(does)):
            self._entities.not_used(does, actor)
        name = self._new_name(_name(event))
        if _is_added(action):
            # Conditions know its event by the name of the entity.
            name = self._entities.add(action.child("GlobalAction", "EntityAction"))
        self._steps.append(_Step(name, action, actor, event, act, family))
        self._triggers.families[name] = family
        self._triggers.elements.setdefault(("action", _name(action)), []).append(name)

    def _new_name(self, wanted: str) -> str:
        """A name of an event that no other has."""
        name, number = wanted, 2
        while name in self._names:
            name, number = f"{wanted} {number}", number + 1
        self._names.add(name)
        return name


def _with_final_speeds(events: list[Event]) -> list[Event]:
    """Lets a vehicle arrive ahead of the truck with the speed that its next event gives it.

    That event begins at the end of its way there, and its speed is relative to the truck's.
    """
    final = {
        condition.event: event.speed_difference
        for event in events
        if isinstance(event, ChangeSpeed) and event.speed_difference is not None
        for group in event.when or ()
        for condition in group
        if event.to == TRUCK and condition.state == "ended" and condition.event is not None
    }
    return [
        dataclasses.replace(event, speed_difference=final[event.title])
        if isinstance(event, KeepDistance) and event.ahead and event.title in final
        else event
        for event in events
    ]


def _set(variable: str, value: float | str) -> Values:
    return {"event": "set_value", "variable": variable, "value": value}


def _is_added(action: Node) -> bool:
    """Whether an action adds an entity."""
    return any(True for _ in action.all("AddEntityAction"))


def _name(node: Node) -> str:
    """Name of an element; files that follow no schema leave it out."""
    return node.get("name", node.tag)


def _once(node: Node) -> None:
    if node.get("maximumExecutionCount", "1") != "1":
        node.fail("maximumExecutionCount: only 1 is read")
