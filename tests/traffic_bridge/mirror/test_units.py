"""The compiled poses of the bodies, bit for bit those of the same equations in Python."""

import copy
import math
import pickle

import numpy as np
import pytest

from iits_mj.core.messages import TrackedVehicle
from iits_mj.core.vehicles import VehicleFrame
from iits_mj.kernels import Table, address
from traffic_bridge.mirror import slots, units
from traffic_bridge.mirror.looks import LOOKS
from traffic_bridge.mirror.slots import Slot
from traffic_bridge.mirror.units import CRAWL, NOWHERE, PACE_BAND, TIGHT_TURN, VehicleUnits
from traffic_bridge.vehicles.types import default_types

STEP = 0.1


def hypot(x, y):
    # Python's own hypot rounds otherwise than the C library's.
    return float(np.hypot(x, y))


def moved(state, last, elapsed):
    """x, y, z, yaw, pitch and roll of one vehicle."""
    x, y, z, yaw, pitch, roll, yaw_rate, speed, acceleration, lateral = state
    covered = hypot(x - last[0], y - last[1])
    pace = covered / (STEP * max(hypot(speed, lateral), CRAWL))
    pitch_rate = roll_rate = climb = 0.0
    if abs(pace - 1.0) > PACE_BAND:
        pace = 1.0
    else:
        pitch_rate, roll_rate = (pitch - last[4]) / STEP, (roll - last[5]) / STEP
        climb = (z - last[2]) / covered + math.tan(pitch - 0.5 * (pitch - last[4]))
    way = elapsed * pace * (speed + 0.5 * acceleration * (STEP + elapsed))
    if elapsed > 0.0:
        way = max(way, 0.0)
    turn = elapsed * yaw_rate
    chord = yaw + 0.5 * turn
    if lateral:
        slide = math.atan2(lateral, max(speed, CRAWL))
        chord = chord + slide - math.atan2(lateral, max(speed, TIGHT_TURN))
        way = way / math.cos(slide) if speed > CRAWL else way
    tilt = elapsed * pitch_rate
    return (
        x + way * math.cos(chord),
        y + way * math.sin(chord),
        z + way * (climb - math.tan(pitch + 0.5 * tilt)),
        *(yaw + turn, pitch + tilt, roll + elapsed * roll_rate),
    )


def quaternion(yaw, pitch, roll):
    cy, cp, cr = (math.cos(0.5 * angle) for angle in (yaw, pitch, roll))
    sy, sp, sr = (math.sin(0.5 * angle) for angle in (yaw, pitch, roll))
    return (
        cp * cr * cy + sp * sr * sy,
        cp * sr * cy - sp * cr * sy,
        sp * cr * cy + cp * sr * sy,
        cp * cr * sy - sp * sr * cy,
    )


def articulated(kingpin, axles, trailer, pose):
    """The kingpin, and the quaternions of tractor and semitrailer."""
    x, y, z, yaw, pitch, roll = pose
    bend, delta = trailer - yaw, yaw - trailer
    cy, sy = math.cos(yaw), math.sin(yaw)
    cp, sp, cr, sr = math.cos(pitch), math.sin(pitch), math.cos(roll), math.sin(roll)
    forward, left = kingpin * math.cos(bend), kingpin * math.sin(bend)
    place = (
        x + forward * cy * cp + left * (cy * sp * sr - sy * cr),
        y + forward * sy * cp + left * (sy * sp * sr + cy * cr),
        z - forward * sp + left * cp * sr,
    )
    across = math.sin(delta) * (1.0 + kingpin / axles)
    w, i, j, k = quaternion(yaw, pitch, roll)
    turned = []
    for turn in (trailer + math.atan2(across, math.cos(delta)) - yaw, bend):
        c, s = math.cos(0.5 * turn), math.sin(0.5 * turn)
        turned.append((w * c - k * s, i * c + j * s, j * c - i * s, k * c + w * s))
    return place, *turned


def test_articulated_trucks_have_the_bits_of_the_equations():
    rng = np.random.default_rng(4)
    first, count = 30, 100
    pose, trailer = rng.normal(size=(6, count)), rng.normal(size=count - first)
    now, trucks = Table(pose), Table(rng.uniform(2.0, 9.0, (2, count - first)))
    rows = 2 * count - first
    place, turned = Table(np.zeros((rows, 3))), Table(np.zeros((rows, 4)))
    tables = now, trucks, Table(trailer), place, turned
    units._articulate(first, count, *[table.address for table in tables])
    given = zip(*trucks.numbers, trailer, pose[:, first:].T.tolist(), strict=True)
    places, tractors, trailers = zip(*[articulated(*one) for one in given], strict=True)
    np.testing.assert_array_equal(place.numbers[first:], places * 2)
    np.testing.assert_array_equal(turned.numbers[first:], tractors + trailers)
    assert not place.numbers[:first].any()
    assert not turned.numbers[:first].any()


@pytest.mark.parametrize("elapsed", [-0.1, 0.0, 0.03, 0.1])
def test_poses_have_the_bits_of_the_equations(elapsed):
    rng = np.random.default_rng(3)
    count = 200
    last = rng.normal(size=(10, count))
    last[7], last[9] = rng.uniform(0.0, 30.0, count), rng.normal(size=count)
    last[7, ::5] = rng.uniform(0.0, CRAWL, count // 5)
    state = last + 0.01 * rng.normal(size=last.shape)
    # The pace is near 1 for most vehicles; some are new, and some keep to their lane's center.
    state[0] = last[0] + STEP * state[7] * np.cos(state[3])
    state[1] = last[1] + STEP * state[7] * np.sin(state[3])
    last[0, ::7], state[9, ::2] = NOWHERE, 0.0
    now = Table(np.empty((6, count)))
    tables = Table(state), Table(last)
    limits = CRAWL, TIGHT_TURN, PACE_BAND
    addresses = [table.address for table in tables]
    units._extrapolate(count, *addresses, elapsed, STEP, *limits, now.address)
    rows = zip(state.T.tolist(), last.T.tolist(), strict=True)
    expected = np.array([moved(one, before, elapsed) for one, before in rows])
    np.testing.assert_array_equal(now.numbers.T, expected)
    position, turned = Table(np.empty((count, 3))), Table(np.empty((count, 4)))
    units._place(count, count, now.address, position.address, turned.address)
    np.testing.assert_array_equal(position.numbers, expected[:, :3])
    np.testing.assert_array_equal(
        turned.numbers, [quaternion(*angles) for angles in expected[:, 3:].tolist()]
    )


@pytest.mark.parametrize("seed", range(10))
def test_chosen_vehicles_are_those_of_a_sort_by_type_distance_and_number(seed):
    rng = np.random.default_rng(seed)
    count = int(rng.integers(1, 60))
    places = rng.integers(-4, 5, (2, count)).astype(float)  # many at equal distances
    kinds = rng.integers(0, 3, count)
    held = (rng.random(count) < 0.5).astype(float)
    weight, base = np.where(held, slots.LOYALTY**2, 1.0), slots.APART * kinds
    ranked = np.sort(kinds)
    rank = np.arange(count) - np.searchsorted(ranked, ranked)
    limits = np.where(rank < 5, slots.APART * ranked + 20.0, -1.0)
    key = (places[0] ** 2 + places[1] ** 2) * weight + base
    order = key.argsort(kind="stable")
    expected = np.empty(count)
    expected[order] = key[order] <= limits
    ranking, work = Table((weight, base, limits, held)), Table(np.empty((2, count)))
    chosen = Table(np.empty(count))
    tables = ranking.address, work.address, chosen.address
    changes = slots._choose(count, address(places), 0.0, 0.0, *tables)
    np.testing.assert_array_equal(chosen.numbers, expected)
    assert changes == (expected != held).sum()


@pytest.mark.parametrize("duplicate", [copy.deepcopy, lambda one: pickle.loads(pickle.dumps(one))])
def test_a_copy_has_poses_of_its_own(duplicate):
    (car,) = (kind for kind in default_types() if kind.name == "car")
    made = VehicleUnits([car], [LOOKS["car"](car)], STEP)
    made.set_slots([Slot(0, 0, 0, "a", 0)])

    def frame(x):
        return VehicleFrame.of([TrackedVehicle("a", x=x, speed=10.0)])

    made.take(frame(1.0), np.array([0]))
    made.move(0.0)
    other = duplicate(made)
    other.take(frame(2.0), np.array([0]))
    other.move(0.05)
    made.move(0.0)
    assert made.position[0, 0] == 1.0
    assert other.position[0, 0] == pytest.approx(2.5)
