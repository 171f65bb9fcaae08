"""The types of a bag: ROS 2's own, CAN frames, and ours."""

from __future__ import annotations

import functools
from typing import Any

from iits_mj.bag import own_types, standard
from iits_mj.errors import InputError

REMEDY = "pip install 'iits-mj[ros]'"

# Topic to type: the paper's module boundaries, then what others show or convert.
TOPICS = {
    "/drive": "std_msgs/msg/String",
    "/traffic/scene": own_types.type_name(own_types.Scene),
    "/decision": own_types.type_name(own_types.Decided),
    "/planning/trajectory": own_types.type_name(own_types.Trajectory),
    "/control/command": own_types.type_name(own_types.VehicleCommand),
    "/vehicle/command": own_types.type_name(own_types.VehicleCommand),
    "/vehicle/state": own_types.type_name(own_types.EgoState),
    "/vehicle/odometry": "nav_msgs/msg/Odometry",
    "/vehicle/twist": "geometry_msgs/msg/TwistStamped",
    "/tf": "tf2_msgs/msg/TFMessage",
    "/traffic/markers": "visualization_msgs/msg/MarkerArray",
    "/planning/path": "nav_msgs/msg/Path",
    "/can": standard.CAN_TYPE,
}


@functools.cache
def typestore() -> Any:
    """ROS 2 Jazzy's types and ours.

    Raises:
      InputError: rosbags is not installed.
    """
    try:
        from rosbags.typesys import Stores, get_types_from_msg, get_typestore
    except ImportError as error:
        raise InputError(f"bags need rosbags: {REMEDY}") from error
    store = get_typestore(Stores.ROS2_JAZZY)
    store.register(get_types_from_msg(standard.CAN_FRAME, standard.CAN_TYPE))
    for kind in own_types.MESSAGES:
        text = own_types.definition(kind)
        store.register(get_types_from_msg(text, own_types.type_name(kind)))
    return store
