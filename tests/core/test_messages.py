"""Messages built from values in the order of their fields."""

import copy
import dataclasses
import pickle

import pytest

from iits_mj.core.errors import InputError
from iits_mj.core.messages import EgoState, TransmissionMode, VehicleCommand, positional


def values(message):
    return [getattr(message, field.name) for field in dataclasses.fields(message)]


@pytest.mark.parametrize("message", [EgoState(speed=3.0, gear=4), VehicleCommand(brake_pedal=0.2)])
def test_a_message_from_values_in_order_is_like_any_other(message):
    made = positional(type(message))(*values(message))
    assert made == message
    assert type(made) is type(message)
    assert hash(made) == hash(message)
    assert repr(made) == repr(message)
    assert pickle.loads(pickle.dumps(made)) == copy.deepcopy(made) == message
    field = dataclasses.fields(message)[0].name
    assert dataclasses.replace(made, **{field: 9.0}) == dataclasses.replace(message, **{field: 9.0})
    with pytest.raises(dataclasses.FrozenInstanceError):
        setattr(made, field, 1.0)


def test_a_message_needs_all_values():
    with pytest.raises(TypeError, match="missing 1 required positional argument"):
        positional(EgoState)(*values(EgoState())[:-1])


def test_forward_gears_are_requests_of_the_selector():
    assert [TransmissionMode.forward(gear).gear for gear in (1, 12, 18)] == [1, 12, 18]
    assert [mode.gear for mode in TransmissionMode][:3] == [0, 0, 0]
    for gear in (0, 19):
        with pytest.raises(InputError, match="requested gear"):
            TransmissionMode.forward(gear)
