"""A running drive in the browser, which viewers watch, influence and drive themselves."""

from __future__ import annotations

import dataclasses
import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from iits_mj.core.context import Closing
from iits_mj.core.errors import Error, InputError
from iits_mj.core.messages import Scene, Trajectory
from iits_mj.core.timing import CONTROL_PERIOD, CYCLE_PERIOD
from iits_mj.core.units import KMH
from iits_mj.core.vehicles import VehicleFrame
from iits_mj.parameters import check_truck
from iits_mj.render.cameras import Camera
from iits_mj.road import Route
from iits_mj.simulation import DriveConfig, DriveFrame, DriveSummary, Observer, Simulation
from iits_mj.simulation.config import DENSITIES
from iits_mj.simulation.lock_step import LockStep
from iits_mj.simulation.parts import load_route, make_stack
from iits_mj.truck import Truck
from iits_mj.web import instruments
from iits_mj.web.events import WIND_MAX, Events
from iits_mj.web.manual import Hands, ManualDriver, may_reverse
from iits_mj.web.server import WebServer
from iits_mj.web.stage import Stage

# Inputs of a person are used up to this age [s]; then the truck is braked gently, and after
# `_LOST` given back to the automatic driver.
_STALE, _LOST = 0.5, 3.0
_CAREFUL = Hands(brake=0.3)
OVERLAYS = {
    "show_path": "Planned path",
    "show_gaps": "Gaps to other vehicles",
    "show_forces": "Tire loads and forces",
}


@dataclass(frozen=True, slots=True)
class NewDrive:
    """What a viewer chooses for another drive.

    Attributes:
      seed: of everything random; payload: [kg]; density: of the traffic; friction: of the whole
        road, None for the map's.
    """

    seed: int
    payload: float
    density: str
    friction: float | None


class LiveDrive(Stage, Observer, Closing):
    """Drives and shows the drive; a context manager.

    Args:
      server: of the pages.
      config: of the first drive.
      pace: simulated time over wall time.
      camera: with which the pages begin, one of `iits_mj.web.scene.VIEWS` or your own.

    Attributes:
      simulation: that runs; driver: of its truck; events: that can be triggered.
      inputs: a person's inputs, each from a time [s] on.
    """

    def __init__(
        self,
        server: WebServer,
        config: DriveConfig,
        pace: float = 1.0,
        camera: str | type[Camera] | Camera = "chase",
    ) -> None:
        self.config, self.camera = config, camera
        self.friction: float | None = None
        self.inputs: list[tuple[float, Hands]] = []
        self._reverse = False
        self._built: tuple[Any, ...] | None = None
        self.simulation = self._simulate(config)
        self.events = Events(self.simulation)
        super().__init__(server, pace)
        self._handlers |= {
            "take": self._take,
            "release": self._release,
            "speed": self._set_speed,
            "wind": self._set_wind,
            "event": self._trigger,
            "drive": self._drive_again,
        }
        self._add_panel()

    @property
    def now(self) -> float:
        """Simulated time [s]."""
        return self.simulation.time

    @property
    def driver(self) -> ManualDriver:
        """The driver of the truck."""
        assert isinstance(self.simulation.driver, ManualDriver)
        return self.simulation.driver

    @property
    def period(self) -> float:  # type: ignore[override]
        """Simulated time between two pictures, for about 50 pictures a second [s]."""
        return max(self.simulation.timestep, min(CONTROL_PERIOD * self.pace, CYCLE_PERIOD))

    def play(self) -> None:
        """Drives until Ctrl-C; after the end of a drive viewers may start another one."""
        self._show_model()
        while True:
            self.between_cycles()
            if self.simulation.ended:
                self.wait()
                continue
            self.events.advance()
            self._check_person()
            self.simulation.cycle([self])
            if self.simulation.ended:
                self.say(f"The drive has ended: {self.simulation.ended}.", "warning")
                self.observe(self.simulation, self.simulation.frame)

    def summary(self) -> DriveSummary:
        """Returns the figures of the last drive."""
        return self.simulation.summary(None if self.simulation.ended else "interrupted")

    def close(self) -> None:
        """Ends SUMO."""
        self.simulation.close()

    # As an observer of the drive.

    def observe(self, simulation: LockStep, frame: DriveFrame) -> None:
        """Draws the drive and waits for the wall clock."""
        del simulation
        self._frame = frame
        if self.due() or self.paused:
            self.redraw()
        self.hold()

    def planned(self, scene: Scene, trajectory: Trajectory) -> None:
        """Draws the plan and the neighbors' gaps."""
        if self.scene is None:
            return
        self.scene.show_plan(trajectory)
        self.scene.show_lights(scene.signals, scene.time)
        frame = VehicleFrame.of(scene.vehicles)
        self.scene.show_neighbors(scene.time, frame, instruments.gap_texts(scene))

    def redraw(self) -> None:
        """Draws the present instant."""
        from iits_mj.web.scene import Poses

        scene, truck = self.scene, self.simulation.truck
        if scene is not None:
            scene.show(Poses.of(truck.data), self._frame.ego.station, self.now)
            scene.show_tires(truck.data)

    def state(self) -> dict[str, Any]:
        """Returns the instruments."""
        frame, driver = self._frame, self.driver
        report = self.simulation.truck.report()
        return {
            **instruments.truck_state(frame.ego, frame.command, report),
            **instruments.drive_state(frame),
            "choice": [] if driver.driving else instruments.choice(driver.automatic),
        }

    # A person at the wheel.

    def _check_person(self) -> None:
        age = time.monotonic() - self.given[1]
        if self.driver.driving and self.holder and not self.paused and age > _LOST:
            self.say("No input from the driver's page: the automatic driver drives.", "warning")
            self.left(self.holder)

    def hands(self, now: float) -> Hands:
        """Returns the inputs in force at a simulated time [s]."""
        hands, stamp = self.given
        if time.monotonic() - stamp > _STALE:
            hands = _CAREFUL
        # The gearbox changes its direction at standstill only.
        if may_reverse(self._frame.ego):
            self._reverse = hands.reverse
        hands = dataclasses.replace(hands, reverse=self._reverse)
        if not self.inputs or self.inputs[-1][1] != hands:
            self.inputs.append((now, hands))
        return hands

    # Requests.

    def _take(self, value: Any) -> None:
        del value
        self._reverse = False
        self.driver.take()
        self.say("A viewer drives.")

    def _release(self, value: Any) -> None:
        del value
        self.driver.release()
        self.say("")

    def _set_speed(self, value: float) -> None:
        """Changes the set speed [m/s]: a new automatic driver begins from here."""
        changed = dataclasses.replace(self.config, speed=value)
        simulation = self.simulation
        stack = make_stack(changed, simulation.route, simulation.truck.parameters)
        self.driver.replace(stack)
        self.config = changed

    def _set_wind(self, value: float) -> None:
        self.events.wind = value

    def _trigger(self, value: str) -> None:
        self.say(f"{value}: {self.events.trigger(value)}.")

    def _drive_again(self, value: NewDrive) -> None:
        """Starts another drive.

        Raises:
          InputError: a value is not allowed.
        """
        config = dataclasses.replace(
            self.config, seed=value.seed, payload=value.payload, density=value.density
        )
        self.say("Building the next drive …")
        self.tell()
        # libsumo holds one simulation in a process.
        self.simulation.close()
        try:
            self.friction = value.friction
            self.simulation = self._simulate(config)
        except Error as error:
            self.simulation.stop("the next drive could not be started")
            raise InputError(f"the next drive could not be started: {error}") from error
        self.config = config
        wind, self.events = self.events.wind, Events(self.simulation)
        self.events.wind = wind
        self.holder = 0
        self._show_model()
        self.jump()
        self.say("")

    def _simulate(self, config: DriveConfig) -> Simulation:
        route = load_route(config)
        if self.friction is not None:
            route = route.with_friction(self.friction)

        def driver(road: Route, truck: Truck) -> ManualDriver:
            stack = make_stack(config, road, truck.parameters)
            return ManualDriver(stack, road, truck.parameters, self.hands)

        simulation = Simulation(config, driver=driver, route=route)
        self._frame = simulation.frame
        self.inputs = []
        return simulation

    def _show_model(self) -> None:
        """Sends the model to the pages if it is another one."""
        # Loading viser takes half a second.
        from iits_mj.web.scene import Poses, TruckScene

        truck, config = self.simulation.truck, self.config
        key = (config.payload, config.map, config.route, config.truck, config.payload_height)
        if self._built != key:
            if self.scene is not None:
                self.scene.remove()
            self._built = key
            route = self.simulation.route
            before = self.scene
            self.scene = TruckScene(
                self.server.viser,
                truck.model,
                truck.parameters,
                tuple(route.tunnels),
                camera=self.camera,
            )
            self.scene.keep_views(before)
            self.scene.initial_camera(Poses.of(truck.data))
        self.planned(self.simulation.scene, self.simulation.trajectory)
        self.redraw()

    # The panel.

    def _add_panel(self) -> None:
        gui, put = self.server.viser.gui, self.requests.put
        with gui.add_folder("While driving"):
            speed = gui.add_slider(
                "Set speed [km/h]",
                min=20,
                max=90,
                step=1,
                initial_value=round(self.config.speed / KMH),
            )
            speed.on_update(lambda _: put("speed", speed.value * KMH))
            wind = gui.add_slider(
                "Wind from left [m/s]", min=-WIND_MAX, max=WIND_MAX, step=1.0, initial_value=0.0
            )
            wind.on_update(lambda _: put("wind", float(wind.value)))
        with gui.add_folder("Events", expand_by_default=False):
            for name in self.events.names:
                self.on_click(gui.add_button(name), self.requests, "event", _constant(name))
        self._add_new_drive()
        self.add_overlays(OVERLAYS)

    def _add_new_drive(self) -> None:
        """Adds what needs another model or another traffic."""
        gui, config = self.server.viser.gui, self.config
        parameters = check_truck(config)
        largest = parameters.payload_max / 1e3
        payload = parameters.check_payload(config.payload) / 1e3
        with gui.add_folder("New drive", expand_by_default=False):
            gui.add_markdown("These take effect with the button below.")
            seed = gui.add_number("Seed", config.seed, min=0, max=2**31 - 1, step=1)
            load = gui.add_slider(
                "Payload [t]", min=0.0, max=largest, step=0.1, initial_value=payload
            )
            friction = gui.add_slider(
                "Road friction [-]", min=0.1, max=1.0, step=0.05, initial_value=0.8
            )
            density = gui.add_dropdown("Traffic", DENSITIES, initial_value=config.density)

            def chosen() -> NewDrive:
                chose = float(friction.value)
                return NewDrive(
                    int(seed.value),
                    min(1e3 * float(load.value), parameters.payload_max),
                    str(density.value),
                    None if abs(chose - 0.8) < 1e-6 else chose,
                )

            self.on_click(gui.add_button("Start the new drive"), self.requests, "drive", chosen)


def _constant(name: str) -> Callable[[], str]:
    return lambda: name
