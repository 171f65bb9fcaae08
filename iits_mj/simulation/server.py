"""The truck as a device under test: it obeys a CAN bus and reports on it, in soft real time.

A tick lasts 10 ms. At each tick the truck sends its reports of that instant; then it obeys the
frames received since the last tick for the following 10 ms.
"""

from __future__ import annotations

import dataclasses
import itertools
import time
from collections.abc import Callable

from controllers.safe_stop.fallback import Fallback
from controllers.safe_stop.stop import SafeStop
from iits_mj.core.checks import positive
from iits_mj.core.context import Closing
from iits_mj.core.errors import BusError, Error
from iits_mj.core.messages import EgoState, TruckReport, VehicleCommand
from iits_mj.core.timing import TIMESTEP
from iits_mj.j1939 import CommandReceiver, Frame, Link, LinkState, LogWriter
from iits_mj.j1939.bus import LinkChange
from iits_mj.j1939.network import ControlUnits, truck_addresses, unit_names
from iits_mj.j1939.receiver import UNIT_NAMES, Heard, Loss
from iits_mj.j1939.state import TruckSender
from iits_mj.parameters import TruckParameters
from iits_mj.simulation.config import ServeConfig
from iits_mj.simulation.frame import Ending, check_finite, find_ending, find_leaving
from iits_mj.simulation.parts import load_route, placed
from iits_mj.simulation.summary import ServeSummary
from iits_mj.truck import Truck

# A tick of the server [s].
TICK = 0.01
TICK_STEPS = round(TICK / TIMESTEP)


class Pace:
    """Waits for ticks of a fixed period and measures their lateness.

    After a late tick the next ticks do not wait until the clock is reached again; no tick is
    skipped. When the lag exceeds `longest_lag`, the clock is set back instead: simulated time stays
    behind, and `slipped` adds up the difference.

    Args:
      period: of a tick [s]; a tick is late when it lags by more than half of it.
      longest_lag: longest lag that is caught up [s].
      clock: monotonic time [s]; sleep: waits for a number of seconds.

    Attributes:
      ticks, late: number of ticks and of late ticks; worst, total: lateness of the ticks [s].
      slips: number of times that the clock was set back; slipped: total time [s].
    """

    def __init__(
        self,
        period: float,
        *,
        longest_lag: float = 0.05,
        clock: Callable[[], float] = time.monotonic,
        sleep: Callable[[float], None] = time.sleep,
    ) -> None:
        for name, value in (("period", period), ("longest_lag", longest_lag)):
            positive(f"pace: {name}", value, "s")
        self.period = period
        self.longest_lag = longest_lag
        self._clock, self._sleep = clock, sleep
        self.ticks = self.late = self.slips = 0
        self.worst = self.total = self.slipped = 0.0
        self._start: float | None = None
        self._since_start = 0

    @property
    def mean(self) -> float:
        """Mean lateness of a tick [s]."""
        return self.total / self.ticks if self.ticks else 0.0

    def wait(self) -> float:
        """Waits until the next tick is due; returns its lateness [s]. The first is due at once."""
        now = self._clock()
        if self._start is None:
            self._start = now
        due = self._start + self._since_start * self.period
        # Rounding of the clock may end a sleep early.
        while (ahead := due - now) > 0.0:
            self._sleep(ahead)
            now = self._clock()
        lateness = now - due
        self._since_start += 1
        self.ticks += 1
        self.total += lateness
        self.worst = max(self.worst, lateness)
        self.late += lateness > 0.5 * self.period
        if lateness > self.longest_lag:
            self.slips += 1
            self.slipped += lateness
            self._start, self._since_start = now, 1
        return lateness


class TruckBus(Closing):
    """Reports a truck on a link, answers requests, and passes commands to a receiver.

    Args:
      link: the bus; `close` closes it.
      receiver: gets every received frame.
      parameters: of the truck, for its percent torques and configurations.
      log: gets every frame, sent and received, until a write fails; `close` closes it.

    Attributes:
      link, receiver: the arguments; units: the truck's control units in the network.
      log_failure: why the log ends early, "" when it is complete.
    """

    def __init__(
        self,
        link: Link,
        receiver: CommandReceiver,
        parameters: TruckParameters,
        log: LogWriter | None = None,
    ) -> None:
        self.link = link
        self.receiver = receiver
        self._sender = TruckSender(parameters)
        self._log = log
        self.log_failure = ""
        self._state, self._report = EgoState(), TruckReport()
        self._due: list[Frame] = []
        # The units claim addresses before the first frame, and again after the bus reopens.
        self._claimed_at_restart = -1
        self.units = ControlUnits(unit_names(sorted(truck_addresses())))

    def prepare(self, state: EgoState, report: TruckReport) -> None:
        """Encodes the frames that are due at the state's time; `exchange` sends them.

        Raises:
          BusError: a value is not finite.
        """
        self._state, self._report = state, report
        self._due = self._sender.frames(state, report)

    def exchange(self, time: float) -> None:
        """Sends the prepared frames, passes received frames to the receiver, answers requests.

        `time` [s] is that of all frames sent and received.
        """
        if self._claimed_at_restart != self.link.restarts:
            self._claimed_at_restart = self.link.restarts
            self._send(self.units.claims(time))
        self._send([frame for frame in self._due if self.units.owns(frame)])
        self._due = []
        heard = self.link.receive(time)
        for frame in heard:
            self._log_frame(frame)
            self.receiver.receive(frame)
        self._send(self.units.answer(heard, self._groups, time))

    def close(self) -> None:
        """Leaves the bus and finishes the log."""
        self.link.close()
        self.finish_log()

    def finish_log(self) -> None:
        """Completes the log and continues without a log; may be called again."""
        log, self._log = self._log, None
        if log is None:
            return
        try:
            log.close()
        except BusError as error:
            self.log_failure = self.log_failure or str(error)

    def _log_frame(self, frame: Frame) -> None:
        """Logs a frame; after a failed write the bus continues without the log."""
        if self._log is None:
            return
        try:
            self._log.write(frame)
        except BusError as error:
            self.log_failure = str(error)
            self.finish_log()

    def _groups(self, pgn: int, address: int) -> list[Frame] | None:
        return self._sender.answer(pgn, address, self._state, self._report)

    def _send(self, frames: list[Frame]) -> None:
        for frame in frames:
            if self.link.send(frame):
                self._log_frame(frame)


class Server(Closing):
    """A truck on a CAN bus; a context manager.

    Args:
      config: truck, start and bus.
      tell: called with a line of text when the bus or the commands are lost or return, and when
        the log is lost.
      clock: monotonic time [s]; sleep: waits for a number of seconds.

    Attributes:
      config, route, truck, pace: the parts; receiver: of the commands; bus: the truck's end of it.
      state: of the truck now; command: obeyed now.
      silent: True while required commands are missing.
      ended: reason of the end, "" before it; failed: the truck rolled over or left the road, or
        the simulation diverged.

    Raises:
      MapError: the map cannot be read. InputError: the start is not on the route.
      BusError: the bus cannot be opened, or the log cannot be written.
    """

    def __init__(
        self,
        config: ServeConfig,
        *,
        tell: Callable[[str], None] | None = None,
        clock: Callable[[], float] = time.monotonic,
        sleep: Callable[[float], None] = time.sleep,
    ) -> None:
        self.config = config
        self.route = load_route(config)
        self.truck = Truck.load(
            config.payload,
            truck=config.truck,
            payload_height=config.payload_height,
            route=self.route,
            timestep=TIMESTEP,
            plant=config.plant,
            visuals=False,
        )
        self.config = config = placed(config, self.route, self.truck.footprint)
        self.state: EgoState = self.truck.reset(
            station=config.start_station,
            offset=float(self.route.lane_offset(config.start_lane, config.start_station)),
            speed=config.start_speed,
        )
        stop = SafeStop(self.route, self.truck.parameters)
        stop.prepare(self.state)
        self._fallback = Fallback(stop)
        self.receiver = CommandReceiver(
            sources=None if config.any_source else (config.source,),
            steering_angle_max=self.truck.parameters.steering.angle_max,
        )
        self.pace = Pace(TICK, clock=clock, sleep=sleep)
        self.command = VehicleCommand()
        self.silent = True
        self.ended, self.failed = "", False
        self._tell = tell or (lambda _line: None)
        self._clock = clock
        self._ticks = self._silences = self._silent_ticks = 0
        self._last_change: LinkChange | None = None
        self._log_reported = False
        self._reported_addresses: set[int] = set()
        self._reported_limits: set[str] = set()
        self._reported_senders: set[tuple[str, int]] = set()
        self._obeyed = (
            "it is the truck's own address"
            if config.any_source
            else f"the sender to obey is 0x{config.source:02X}; --source selects another"
        )
        self._distance = 0.0
        self._max_speed = self.state.speed
        self.bus = self._join()
        self.bus.prepare(self.state, self.truck.report())

    def _join(self) -> TruckBus:
        config = self.config
        log = None if config.can_log is None else LogWriter(config.can_log)
        try:
            link = Link(config.bus, config.channel, reach=config.reach, clock=self._clock)
        except BaseException:
            if log is not None:
                log.close()
            raise
        return TruckBus(link, self.receiver, self.truck.parameters, log)

    @property
    def time(self) -> float:
        """Simulated time [s], a multiple of a tick."""
        return self._ticks * TICK

    def tick(self) -> None:
        """Waits until the next tick is due and serves it.

        After a divergence of the simulation, serving ends with the state before that tick.
        """
        self.pace.wait()
        self.bus.exchange(self.time)
        self._report_bus()
        self._report_log()
        self._report_network()
        self._report_range()
        self.command = self._decide()
        self.truck.command(self.command)
        try:
            state = self._advance()
        except Error as error:
            self._end(Ending(str(error), failed=True))
            return
        self._ticks += 1
        self._distance += 0.5 * (self.state.speed + state.speed) * TICK
        self.state = state
        self._max_speed = max(self._max_speed, self.state.speed)
        self._check_end()

    def run(self) -> ServeSummary:
        """Serves until the time or the road ends or `stop` is called; completes the log."""
        wall, processor = self._clock(), time.process_time()
        while not self.ended:
            self.tick()
        elapsed, processor = self._clock() - wall, time.process_time() - processor
        self.bus.finish_log()
        self._report_log()
        return self.summary(processor / elapsed if elapsed > 0.0 else 0.0)

    def stop(self, reason: str) -> None:
        """Ends serving after the present tick; signal handlers and threads may call it."""
        self.ended = self.ended or reason

    def summary(self, processor_load: float = 0.0) -> ServeSummary:
        """Returns the figures so far."""
        link, pace = self.bus.link, self.pace
        return ServeSummary(
            ended=self.ended or "still serving",
            failed=self.failed,
            duration=self.time,
            distance=self._distance,
            mean_speed=self._distance / self.time if self._ticks else 0.0,
            max_speed=self._max_speed,
            last_speed=self.state.speed,
            accepted=dict(self.receiver.accepted),
            rejected=dict(self.receiver.rejected),
            passed_over=dict(self.receiver.ignored),
            lost=self.receiver.lost,
            silences=self._silences,
            silent_time=self._silent_ticks * TICK,
            sent=link.sent,
            received=link.received,
            dropped=link.dropped,
            ignored=dict(link.ignored),
            requests=dict(self.bus.units.counts),
            lost_addresses=sorted(self.bus.units.lost),
            bus_failures=link.failures,
            bus_restarts=link.restarts,
            bus_state=link.state.value,
            log_failure=self.bus.log_failure,
            ticks=pace.ticks,
            late_ticks=pace.late,
            worst_lateness=pace.worst,
            mean_lateness=pace.mean,
            slips=pace.slips,
            slipped=pace.slipped,
            processor_load=processor_load,
            left_range=self.truck.left_range,
        )

    def close(self) -> None:
        """Leaves the bus and finishes the log."""
        self.bus.close()

    def _advance(self) -> EgoState:
        """Advances the physics by a tick and prepares the reports of the new state.

        Raises:
          Error: the simulation diverged.
        """
        self.truck.step(TICK_STEPS)
        state = self.truck.observe()
        check_finite(state)
        self.bus.prepare(state, self.truck.report())
        return state

    def _decide(self) -> VehicleCommand:
        """Returns the command to obey now, from the bus or from the fallback."""
        received = self.receiver.command(self.time)
        loss = self.receiver.loss(self.time)
        self._watch_loss(loss)
        if loss.body is Heard.NEVER and self.config.start_speed == 0.0:
            # No controller has sent a command yet: the truck stays parked.
            return dataclasses.replace(received, parking_brake=1.0)
        if self.config.on_silence == "stop":
            # A controller that no longer gets the truck's reports cannot drive it.
            lost = loss.driver or bool(self.bus.units.lost)
            return self._fallback.command(self.state, received, lost)
        return received

    def _watch_loss(self, loss: Loss) -> None:
        """Counts and reports losses and returns of the commands."""
        self._silent_ticks += loss.body is not Heard.NEVER and loss.driver
        if loss.driver == self.silent:
            return
        self.silent = loss.driver
        if self.silent:
            self._silences += 1
            missing = ", ".join(UNIT_NAMES[name] for name in loss.silent)
            self._tell(f"commands lost at t = {self.time:.2f} s: {missing}")
        else:
            self._tell(f"commands obeyed from t = {self.time:.2f} s")

    def _report_bus(self) -> None:
        """Reports the changes of the link since the last tick, in their order."""
        link = self.bus.link
        new = list(
            itertools.takewhile(lambda c: c is not self._last_change, reversed(link.changes))
        )
        for change in reversed(new):
            self._last_change = change
            if change.state is LinkState.UP:
                self._tell(f"CAN bus {link.name} is up again")
            else:
                why = f": {change.reason}" if change.state is LinkState.DOWN else ""
                self._tell(f"CAN bus {link.name} is {change.state.value}, will be reopened{why}")

    def _report_network(self) -> None:
        """Reports each lost address, and each sender of commands that is not obeyed, once."""
        for address in self.bus.units.lost - self._reported_addresses:
            self._reported_addresses.add(address)
            self._tell(
                f"address 0x{address:02X} is claimed by another node at t = {self.time:.2f} s: the "
                "truck's reports from it end, and the truck stops"
            )
        for sender in self.receiver.strangers.keys() - self._reported_senders:
            self._reported_senders.add(sender)
            message, address = sender
            self._tell(
                f"{message} from address 0x{address:02X} is not obeyed (t = {self.time:.2f} s): "
                f"{self._obeyed}"
            )

    def _report_range(self) -> None:
        """Reports each limit of the plant's validity that is exceeded, once."""
        for limit in self.truck.left_range:
            if limit not in self._reported_limits:
                self._reported_limits.add(limit)
                self._tell(
                    f"the plant {self.truck.plant} is not valid from t = {self.time:.2f} s on: "
                    f"{limit}"
                )

    def _report_log(self) -> None:
        """Reports once that the log ended early."""
        if self.bus.log_failure and not self._log_reported:
            self._log_reported = True
            self._tell(f"the log ends at t = {self.time:.2f} s: {self.bus.log_failure}")

    def _check_end(self) -> None:
        place = (self.state, self.route, self.truck.footprint)
        found = find_ending(*place) or find_leaving(self.state, self.route)
        duration = self.config.duration
        if found is not None:
            self._end(found)
        elif duration is not None and self.time >= duration - 0.5 * TICK:
            self.stop("reached the end of the time")

    def _end(self, ending: Ending) -> None:
        if not self.ended:
            self.failed = ending.failed
        self.stop(ending.reason)
