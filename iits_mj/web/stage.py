"""What all viewers have in common: the panel, the pace, pausing, cameras and overlays.

One thread, that of `run`, works with the model and the traffic. The callbacks of the page only put
requests into queues: those that change what is seen are applied at every shown instant, those that
change the simulation between two cycles.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, Any

from iits_mj.core.errors import Error
from iits_mj.core.own_parts import part_name
from iits_mj.web.manual import Hands
from iits_mj.web.requests import Handler, Requests

if TYPE_CHECKING:
    import viser

    from iits_mj.render.cameras import Camera
    from iits_mj.web.scene import TruckScene
    from iits_mj.web.server import WebServer

PACES = {"1/10": 0.1, "1/4": 0.25, "1/2": 0.5, "1": 1.0, "2": 2.0, "4": 4.0, "8": 8.0}
# A pause of the wall clock beyond this is not caught up [s].
_LATE = 0.25
_FRAME = 1.0 / 50.0  # shortest time between two pictures [s]
# Time for the pages to show an error before the server ends [s].
_FAREWELL = 1.0
_STEP = 0.1  # simulated time of a single step [s]


class Stage:
    """Base of the viewers.

    Args:
      server: of the pages.
      pace: simulated time over wall time.

    Attributes:
      camera: with which the pages begin.
      server: as given; scene: what the pages show, None before the first model.
      requests: that change the simulation; looks: that change what is seen.
      holder: number of the page that has the wheel, 0 for none; given: its newest inputs and when
        they came, by the monotonic clock [s].
    """

    scene: TruckScene | None = None
    camera: str | type[Camera] | Camera = "chase"

    def __init__(self, server: WebServer, pace: float = 1.0) -> None:
        self.server = server
        self.pace = pace
        self.requests, self.looks = Requests(), Requests()
        self._until: float | None = None
        self._anchor = (0.0, time.perf_counter())
        self._drawn = 0.0
        self._message, self._level = "", "info"
        self.holder, self.given = 0, (Hands(), -math.inf)
        self._handlers: dict[str, Handler] = {}
        self._look_handlers: dict[str, Handler] = {
            "pause": self._set_paused,
            "step": self._step,
            "pace": self._set_pace,
            "view": self._set_view,
            "overlay": self._set_overlay,
        }
        self._make_panel(server.viser)
        server.page = self

    # What subclasses define.

    def play(self) -> None:
        """Shows everything until it is over or interrupted."""
        raise NotImplementedError

    @property
    def now(self) -> float:
        """Time that is shown [s]."""
        raise NotImplementedError

    def redraw(self) -> None:
        """Draws the present instant again, for another camera or overlay."""

    def state(self) -> dict[str, Any]:
        """Returns the instruments."""
        return {}

    # Messages of the pages; called in the server's thread.

    def message(self, page: int, content: dict[str, Any]) -> None:
        """Receives a wish to pause, inputs, and who takes or releases the wheel."""
        if content.get("request") == "pause":
            self.looks.put("pause")
        elif content.get("take") is True and not self.holder and "take" in self._handlers:
            self.holder, self.given = page, (Hands(), time.monotonic())
            self.requests.put("take")
        elif page == self.holder:
            if content.get("release") is True:
                self.left(page)
            elif isinstance(content.get("hands"), dict):
                self.given = Hands.of(content["hands"]), time.monotonic()

    def left(self, page: int) -> None:
        """Gives the wheel back when the page that has it is closed."""
        if page == self.holder:
            self.holder = 0
            self.requests.put("release")

    # Running.

    def run(self) -> bool:
        """Shows everything; returns whether it was interrupted by Ctrl-C.

        Raises:
          Error: the simulation failed; the pages show it, too.
        """
        try:
            self.play()
        except KeyboardInterrupt:
            self._part("The simulation was ended.")
            return True
        except Error as error:
            self._part(str(error))
            raise
        except Exception as error:
            self._part(f"fault in the program: {type(error).__name__}: {error}")
            raise
        return False

    def _part(self, text: str) -> None:
        self.server.tell("error", text)
        time.sleep(_FAREWELL)

    @property
    def paused(self) -> bool:
        """Whether the time that is shown stands still."""
        return self._until is not None and self.now >= self._until - 1e-9

    def between_cycles(self) -> None:
        """Applies what changes the simulation, and waits while paused."""
        self._apply()
        while self.paused:
            self.hold()
            self._apply()

    def hold(self) -> None:
        """Waits until the wall clock reaches the time that is shown, and while paused.

        A pause ends early for a request that changes the simulation.
        """
        self._look()
        self.tell()
        while self.paused and self.requests.empty:
            if self._look(_FRAME):
                self.redraw()
            self.tell()
            self._restart_clock()
        while (ahead := self._ahead()) > 0.0:
            if self._look(min(ahead, 2.0 * _FRAME)) and self.paused:
                return self.hold()
        if ahead < -_LATE:
            self._restart_clock()
        return None

    def wait(self) -> None:
        """Waits for a request while nothing moves."""
        self._look()
        self.redraw()
        self.tell()
        self._apply(timeout=2.0 * _FRAME)
        self._restart_clock()

    def due(self) -> bool:
        """Returns whether it is time for another picture."""
        now = time.perf_counter()
        if now - self._drawn < 0.8 * _FRAME:
            return False
        self._drawn = now
        return True

    def say(self, text: str, level: str = "info") -> None:
        """Shows a text on all pages until the next one."""
        self._message, self._level = text, level

    def tell(self) -> None:
        """Sends the instruments to all pages, at most ten times a second."""
        now = time.perf_counter()
        if now - self._told < 0.095:
            return
        self._told = now
        common = {
            "paused": self.paused,
            "message": self._message,
            "level": self._level,
            "holder": self.holder,
            "manual": "take" in self._handlers,
        }
        self.server.tell("state", {**self.state(), **common})

    def jump(self) -> None:
        """Is called when the time has jumped; a pause goes on from there."""
        if self._until is not None:
            self._until = self.now
        self._restart_clock()

    _told = 0.0

    def _apply(self, timeout: float | None = None) -> None:
        self._say_all(self.requests.apply(self._handlers, self.now, timeout))

    def _say_all(self, refused: Sequence[str]) -> None:
        for text in refused:
            self.say(text, "warning")

    def _look(self, timeout: float | None = None) -> bool:
        """Applies what changes only what is seen; returns whether there was anything."""
        before = len(self.looks.applied)
        self._say_all(self.looks.apply(self._look_handlers, self.now, timeout))
        found = len(self.looks.applied) > before
        self.looks.applied.clear()
        return found

    def _ahead(self) -> float:
        """Returns how far the shown time is ahead of the wall clock, in wall time [s]."""
        shown, wall = self._anchor
        return (self.now - shown) / self.pace - (time.perf_counter() - wall)

    def _restart_clock(self) -> None:
        self._anchor = (self.now, time.perf_counter())

    # Requests.

    def _set_paused(self, value: bool | None) -> None:
        paused = not self.paused if value is None else value
        self._until = self.now if paused else None
        self._restart_clock()
        self._pause.label = "Resume" if paused else "Pause"

    def _step(self, value: Any) -> None:
        del value
        self._until = self.now + _STEP
        self._restart_clock()
        self._pause.label = "Resume"

    def _set_pace(self, value: float) -> None:
        self.pace = value
        self._restart_clock()

    def _set_view(self, value: tuple[int, str]) -> None:
        if self.scene is not None:
            self.scene.use_view(*value)

    def _set_overlay(self, value: tuple[str, bool]) -> None:
        if self.scene is not None:
            setattr(self.scene, *value)

    # The panel.

    def _make_panel(self, page: viser.ViserServer) -> None:
        gui = page.gui
        with gui.add_folder("Time"):
            self._pause = gui.add_button("Pause")
            self.on_click(self._pause, self.looks, "pause")
            self.on_click(gui.add_button(f"Step {_STEP:g} s"), self.looks, "step")
            near = min(PACES, key=lambda name: abs(PACES[name] - self.pace))
            pace = gui.add_dropdown("Pace", tuple(PACES), initial_value=near)
            pace.on_update(lambda _: self.looks.put("pace", PACES[pace.value]))
        page.on_client_connect(self._add_views)

    def _add_views(self, client: viser.ClientHandle) -> None:
        """Adds the choice of camera, one for each page."""
        from iits_mj.web.scene import VIEWS

        first = part_name(self.camera)
        views = VIEWS if first in VIEWS else (*VIEWS, first)
        view = client.gui.add_dropdown("Camera", views, initial_value=first, order=-1.0)
        view.on_update(lambda _: self.looks.put("view", (client.client_id, view.value)))

    def add_overlays(self, names: dict[str, str]) -> None:
        """Adds switches of the scene's overlays, by attribute and text."""
        gui = self.server.viser.gui
        with gui.add_folder("Show", expand_by_default=False):
            for attribute, text in names.items():
                self._add_overlay(gui.add_checkbox(text, True), attribute)

    def _add_overlay(self, box: Any, attribute: str) -> None:
        box.on_update(lambda _: self.looks.put("overlay", (attribute, bool(box.value))))

    @staticmethod
    def on_click(
        button: Any, requests: Requests, name: str, value: Callable[[], Any] = lambda: None
    ) -> None:
        """Lets a button put a request."""
        button.on_click(lambda _: requests.put(name, value()))
