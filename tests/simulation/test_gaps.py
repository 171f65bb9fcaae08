import math

import numpy as np
import pytest

from iits_mj.core.messages import EgoState, Scene, TrackedVehicle
from iits_mj.core.vehicles import COLUMNS, VehicleFrame
from iits_mj.parameters import TruckParameters, shipped_trucks
from iits_mj.simulation import gaps
from tests.core.box_distance import box_distance


def lane_gaps(ego: EgoState, *vehicles: TrackedVehicle) -> tuple[float, float]:
    return Scene(0.0, ego, vehicles).neighbors.corridor_gaps(0)


def square(x: float, y: float, yaw: float = 0.0, half: float = 1.0) -> np.ndarray:
    corners = half * np.array([[1, -1], [1, 1], [-1, 1], [-1, -1]], dtype=float)
    c, s = math.cos(yaw), math.sin(yaw)
    return corners @ np.array([[c, s], [-s, c]]) + [x, y]


@pytest.mark.parametrize(
    ("other", "distance"),
    [
        (square(5.0, 0.0), 3.0),
        (square(4.0, 5.0), math.hypot(2.0, 3.0)),
        (square(5.0, 0.0, yaw=math.pi / 4), 4.0 - math.sqrt(2.0)),
        (square(1.5, 0.3), 0.0),
        (square(0.0, 0.0, half=0.2), 0.0),
    ],
)
def test_box_distance_of_known_squares(other: np.ndarray, distance: float) -> None:
    assert box_distance(square(0.0, 0.0), other) == pytest.approx(distance, abs=1e-12)
    assert box_distance(other, square(0.0, 0.0)) == pytest.approx(distance, abs=1e-12)


def test_crossing_boxes_overlap_without_a_corner_inside() -> None:
    long = square(0.0, 0.0) * [10.0, 0.1]
    assert box_distance(long, long[:, ::-1].copy()) == 0.0


def test_lane_gap_is_bumper_to_bumper() -> None:
    ego = EgoState(station=100.0)
    ahead = TrackedVehicle("a", station=150.0, length=5.0)
    behind = TrackedVehicle("b", station=60.0, length=4.0)
    front, rear = lane_gaps(ego, ahead, behind)
    assert front == pytest.approx(150.0 - 2.5 - (100.0 + 1.4))
    assert rear == pytest.approx((100.0 + 1.4 - 16.5) - 62.0)


def test_vehicle_in_the_next_lane_becomes_the_leader_when_it_overlaps_the_trucks_width() -> None:
    ego = EgoState(station=100.0, offset=0.0)
    beside = TrackedVehicle("a", station=130.0, offset=4.0, lane=1, width=1.9)
    cutting_in = TrackedVehicle("a", station=130.0, offset=2.0, lane=1, width=1.9)
    assert lane_gaps(ego, beside) == (math.inf, math.inf)
    assert lane_gaps(ego, cutting_in)[0] < 30.0


def test_truck_boxes_have_the_legal_length_when_straight_and_bend_at_the_kingpin() -> None:
    parameters = TruckParameters.load()
    tractor, trailer = gaps.truck_boxes(EgoState(), parameters)
    both = np.vstack([tractor, trailer])
    assert np.ptp(both[:, 0]) == pytest.approx(16.5, abs=0.02)
    assert np.ptp(both[:, 1]) == pytest.approx(2.55, abs=0.1)
    # The tractor is turned to the left against the trailer, which stays straight.
    _, bent = gaps.truck_boxes(EgoState(yaw=0.3, articulation=0.3), parameters)
    assert np.ptp(bent[:, 1]) == pytest.approx(2.55, abs=1e-9)


def test_nearest_box_distance_sees_a_car_beside_the_trailer() -> None:
    parameters = TruckParameters.load()
    car = TrackedVehicle("a", x=-8.0, y=4.0, width=1.9, length=4.8)
    distance = gaps.nearest_box_distance(EgoState(), (car,), parameters)
    assert distance == pytest.approx(4.0 - 0.95 - 1.275, abs=1e-6)
    assert gaps.nearest_box_distance(EgoState(), (), parameters) == math.inf


def test_vehicle_on_a_bridge_above_is_neither_ahead_nor_near() -> None:
    parameters = TruckParameters.load()
    ego = EgoState(station=100.0)
    above = TrackedVehicle("a", x=-3.0, z=6.0, yaw=1.5, station=130.0, lane=-1)
    crossing = TrackedVehicle("a", x=-3.0, z=0.2, yaw=1.5, station=130.0, lane=-1)
    uphill = TrackedVehicle("a", x=200.0, z=8.0, station=300.0, lane=0)
    assert gaps.nearest_box_distance(ego, (above,), parameters) == math.inf
    assert gaps.nearest_box_distance(ego, (crossing,), parameters) == 0.0
    assert lane_gaps(ego, above)[0] == math.inf
    assert lane_gaps(ego, uphill)[0] < 200.0


def _distance_by_arrays(corners: np.ndarray, box: np.ndarray) -> float:
    edge = np.roll(box, -1, axis=0) - box
    relative = corners[:, None] - box
    along = np.clip((relative * edge).sum(-1) / (edge * edge).sum(-1), 0.0, 1.0)
    return float(np.linalg.norm(relative - along[..., None] * edge, axis=-1).min())


def test_distance_to_the_nearest_box_is_the_least_of_all_distances_bit_for_bit() -> None:
    parameters, rng = TruckParameters.load(), np.random.default_rng(5)
    apart = 0
    for _ in range(200):
        ego = EgoState(yaw=float(rng.uniform(-4.0, 4.0)), articulation=float(rng.normal(0.0, 0.2)))
        cars = [
            TrackedVehicle(str(i), x=x, y=y, yaw=yaw, length=length, width=2.0)
            for i, (x, y, yaw, length) in enumerate(
                zip(*rng.normal(0.0, 20.0, (3, 6)).tolist(), rng.uniform(2, 17, 6), strict=True)
            )
        ]
        every = [
            min(_distance_by_arrays(unit, box), _distance_by_arrays(box, unit))
            for unit in gaps.truck_boxes(ego, parameters)
            for car in cars
            for box in [_corners(car)]
        ]
        found = gaps.nearest_box_distance(ego, cars, parameters)
        apart += found > 0.0
        assert found in (min(every), 0.0)
    assert apart > 50


def _corners(car: TrackedVehicle) -> np.ndarray:
    forward = np.array([math.cos(car.yaw), math.sin(car.yaw)])
    left = np.array([-forward[1], forward[0]])
    along = 0.5 * car.length * np.array([1.0, 1.0, -1.0, -1.0])[:, None]
    across = 0.5 * car.width * np.array([-1.0, 1.0, 1.0, -1.0])[:, None]
    return np.array([car.x, car.y]) + along * forward + across * left


def test_the_columns_of_a_frame_may_be_views_of_another_table() -> None:
    cars = [TrackedVehicle(str(i), x=20.0 + 9.0 * i, y=3.0 * i) for i in range(3)]
    frame, parameters = VehicleFrame.of(cars), TruckParameters.load()
    columns = np.asfortranarray(frame.columns(*COLUMNS))
    view = VehicleFrame(frame.ids, frame.kinds, np.repeat(frame.lanes, 2)[::2], columns)
    expected = gaps.nearest_box_distance(EgoState(), frame, parameters)
    assert gaps.nearest_box_distance(EgoState(), view, parameters) == expected


@pytest.mark.parametrize("name", shipped_trucks())
def test_boxes_of_every_truck_end_at_its_rear_and_turn_at_its_couplings(name: str) -> None:
    truck = TruckParameters.load(name)
    joints = len(truck.couplings)
    straight = EgoState(rear_articulations=(0.0,) * max(joints - 1, 0))
    boxes = gaps.truck_boxes(straight, truck)
    assert len(boxes) == 1 + joints
    assert np.vstack(boxes)[:, 0].min() == pytest.approx(-truck.rear)
    assert np.ptp(np.vstack(boxes)[:, 0]) == pytest.approx(truck.length)
    # Every joint turns by 0.1 rad, and the unit behind by the sum.
    bent = EgoState(articulation=0.1, rear_articulations=(0.1,) * max(joints - 1, 0))
    for k, box in enumerate(gaps.truck_boxes(bent, truck)):
        forward = box[1] - box[2]
        assert math.atan2(forward[1], forward[0]) == pytest.approx(-0.1 * k)
