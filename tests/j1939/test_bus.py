import time
import uuid

import pytest

from iits_mj.core.errors import BusError
from iits_mj.core.messages import EgoState, VehicleCommand
from iits_mj.j1939 import (
    Bus,
    CommandReceiver,
    Frame,
    LogWriter,
    StateReceiver,
    command_to_frames,
    read_log,
    state_to_frames,
)


def _pair():
    channel = uuid.uuid4().hex
    return Bus("virtual", channel), Bus("virtual", channel)


def test_command_crosses_a_virtual_bus_and_the_state_comes_back():
    controller, truck = _pair()
    with controller, truck:
        for frame in command_to_frames(VehicleCommand(0.5, steering_wheel_angle=0.25), 0):
            controller.send(frame)
        receiver = CommandReceiver()
        for frame in truck.receive(time=0.0):
            receiver.receive(frame)
        assert receiver.command(0.0).steering_wheel_angle == pytest.approx(0.25, abs=5e-4)
        for frame in state_to_frames(EgoState(speed=20.0)):
            truck.send(frame)
        watcher = StateReceiver()
        for frame in controller.receive(time=0.1):
            watcher.receive(frame)
        assert watcher.state().speed == pytest.approx(20.0, abs=2e-3)
        assert controller.receive() == []


def test_a_control_cycle_over_the_virtual_bus_is_fast():
    controller, truck = _pair()
    receiver = CommandReceiver()
    with controller, truck:
        start = time.perf_counter()
        for counter in range(200):
            for frame in command_to_frames(VehicleCommand(0.5), counter):
                controller.send(frame)
            for frame in truck.receive(time=0.0):
                receiver.receive(frame)
        cycle = (time.perf_counter() - start) / 200
    assert receiver.accepted["XBR"] == 200
    # Measured 0.2 ms; the bound leaves room for a busy machine.
    assert cycle < 3e-3


@pytest.mark.parametrize("suffix", ["asc", "log", "blf"])
def test_log_file_gives_the_frames_back(tmp_path, suffix):
    path = tmp_path / f"drive.{suffix}"
    frames = command_to_frames(VehicleCommand(0.3), 7, time=1.5)
    writer = LogWriter(path)
    for frame in frames:
        writer.write(frame)
    writer.close()
    read = list(read_log(path))
    assert [(f.can_id, f.data) for f in read] == [(f.can_id, f.data) for f in frames]


def test_unusable_bus_and_log_give_one_clear_error(tmp_path):
    with pytest.raises(BusError, match="cannot be opened"):
        Bus("no_such_interface", "x")
    with pytest.raises(BusError, match="cannot be read"):
        list(read_log(tmp_path / "missing.asc"))
    with pytest.raises(BusError, match="at most 8"):
        Frame(1, b"\x00" * 9)
