"""The same drive with direct commands and with commands over the bus."""

import numpy as np
import pytest

from iits_mj.core.messages import VehicleCommand, XbrEbiMode, XbrMode
from iits_mj.j1939 import CommandReceiver, command_to_frames
from iits_mj.road import Route
from iits_mj.truck import Truck


def commands():
    """Ten seconds: pull, engine brake and retarder, XBR with integration, the driver's pedal."""
    for k in range(500):
        time = 0.02 * k
        if time < 3.0:
            yield VehicleCommand(accelerator_pedal=0.613)
        elif time < 6.0:
            yield VehicleCommand(engine_brake=0.777, retarder=0.444)
        elif time < 8.0:
            yield VehicleCommand(
                xbr_demand=-1.2345, xbr_mode=XbrMode.MAXIMUM, xbr_ebi_mode=XbrEbiMode.INTEGRATION
            )
        else:
            yield VehicleCommand(brake_pedal=0.123)


def speeds(pass_on):
    truck = Truck.load(payload=10_000.0, route=Route.straight(length=1000.0), visuals=False)
    truck.reset(speed=18.0)
    found = []
    for cycle, command in enumerate(commands()):
        truck.command(pass_on(command, cycle, truck.time))
        truck.step(10)
        found.append(truck.read("tractor_velocity"))
    return np.array(found)


def over_the_bus():
    receiver = CommandReceiver()

    def pass_on(command, cycle, time):
        for frame in command_to_frames(command, cycle, time):
            assert receiver.receive(frame)
        return receiver.command(time)

    return speeds(pass_on)


def test_a_drive_over_the_bus_equals_the_direct_drive_within_the_signals_resolution():
    direct, bus = speeds(lambda command, cycle, time: command), over_the_bus()
    # Every part of the drive changes the speed.
    assert direct[149] > direct[299] + 0.8
    assert direct[299] > direct[399] + 1.5
    assert direct[399] > direct[499] + 1.5
    assert np.abs(bus - direct).max() < 0.03
    assert np.abs(bus - direct).max() > 0.0


def test_a_drive_over_the_bus_is_bit_reproducible():
    assert np.array_equal(over_the_bus(), over_the_bus())


def test_retarder_releases_after_the_time_out_of_its_message():
    truck = Truck.load(payload=0.0, visuals=False)
    truck.reset(speed=20.0)
    receiver = CommandReceiver()
    torques = {}
    for cycle in range(100):
        if truck.time < 1.0:
            for frame in command_to_frames(VehicleCommand(retarder=0.5), cycle, truck.time):
                receiver.receive(frame)
        truck.command(receiver.command(truck.time))
        truck.step(10)
        torques[round(truck.time, 2)] = truck.read("retarder_torque")
    assert torques[1.0] == pytest.approx(0.5 * 3500.0, rel=0.1)
    assert torques[1.08] == pytest.approx(torques[1.0], rel=0.05)
    assert torques[2.0] < 100.0
