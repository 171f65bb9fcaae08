"""What Foxglove shows beside a bag's topics: the truck's model, pictures of the film, a layout.

The model is a `foxglove_msgs/SceneUpdate` with one binary glTF for each unit, fixed to the unit's
frame. The types follow the schemas that Foxglove publishes (github.com/foxglove/foxglove-sdk).
"""

from __future__ import annotations

import io
import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
from PIL import Image

from iits_mj.core.errors import InputError
from iits_mj.model.builder import truck_spec
from iits_mj.parameters import TruckParameters

SCENE_TYPE = "foxglove_msgs/msg/SceneUpdate"
GLTF = "model/gltf-binary"
LAYOUT = "foxglove_layout.json"
# Pictures a second in a bag: those of a film of 960 x 540 take 0.3 MB a second.
PICTURE_RATE = 5.0
_JPEG_QUALITY = 80
_HULLS = 3  # geom group of what collides and is not drawn
_POSE = "geometry_msgs/Pose pose"
_COLOR = "foxglove_msgs/Color color"
_CORNERS = f"geometry_msgs/Point[] points\n{_COLOR}\nfoxglove_msgs/Color[] colors\nuint32[] indices"
_SIZED = f"{_POSE}\ngeometry_msgs/Vector3 size"
_PRIMITIVES = ("Arrow", "Cube", "Sphere", "Cylinder", "Line", "TriangleList", "Text", "Model")
# A type follows the types that it contains.
DEFINITIONS: dict[str, str] = {
    "Color": "float64 r\nfloat64 g\nfloat64 b\nfloat64 a",
    "KeyValuePair": "string key\nstring value",
    "ArrowPrimitive": f"{_POSE}\nfloat64 shaft_length\nfloat64 shaft_diameter\n"
    f"float64 head_length\nfloat64 head_diameter\n{_COLOR}",
    "CubePrimitive": f"{_SIZED}\n{_COLOR}",
    "SpherePrimitive": f"{_SIZED}\n{_COLOR}",
    "CylinderPrimitive": f"{_SIZED}\nfloat64 bottom_scale\nfloat64 top_scale\n{_COLOR}",
    "LinePrimitive": f"uint8 type\n{_POSE}\nfloat64 thickness\nbool scale_invariant\n{_CORNERS}",
    "TriangleListPrimitive": f"{_POSE}\n{_CORNERS}",
    "TextPrimitive": f"{_POSE}\nbool billboard\nfloat64 font_size\nbool scale_invariant\n{_COLOR}\n"
    "string text",
    "ModelPrimitive": f"{_POSE}\ngeometry_msgs/Vector3 scale\n{_COLOR}\nbool override_color\n"
    "string url\nstring media_type\nuint8[] data",
    "SceneEntityDeletion": "builtin_interfaces/Time timestamp\nuint8 type\nstring id",
    "SceneEntity": "builtin_interfaces/Time timestamp\nstring frame_id\nstring id\n"
    "builtin_interfaces/Duration lifetime\nbool frame_locked\n"
    "foxglove_msgs/KeyValuePair[] metadata\n"
    + "\n".join(
        f"foxglove_msgs/{kind}Primitive[] {kind.removesuffix('List').lower()}s"
        for kind in _PRIMITIVES
    ),
    "SceneUpdate": "foxglove_msgs/SceneEntityDeletion[] deletions\n"
    "foxglove_msgs/SceneEntity[] entities",
}


def unit_models(parameters: TruckParameters, payload: float) -> dict[str, bytes]:
    """Returns each unit of a truck as binary glTF, in the frame that the bag's /tf gives it.

    The wheels stand as on a level road. glTF has y upward, so readers turn it to z upward.

    Args:
      parameters: of the truck.
      payload: [kg], which lowers and lifts its axles.

    Raises:
      InputError: mjviser is not installed.
    """
    try:
        import trimesh
        from mjviser.conversions import merge_geoms
    except ImportError as error:
        raise InputError("the truck's model needs mjviser: pip install mjviser") from error
    model = truck_spec(parameters, payload).compile()
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    bodies = [model.body(unit.name).id for unit in parameters.units]
    upright = trimesh.transformations.rotation_matrix(-0.5 * np.pi, (1.0, 0.0, 0.0))
    scenes = {body: trimesh.Scene() for body in bodies}
    for part in range(1, model.nbody):
        first = int(model.body_geomadr[part])
        owned = range(first, first + int(model.body_geomnum[part]))
        drawn = [g for g in owned if model.geom_group[g] != _HULLS and model.geom_rgba[g, 3] > 0.0]
        unit = part
        while unit not in scenes and unit > 0:
            unit = int(model.body_parentid[unit])
        if not drawn or unit not in scenes:
            continue
        placed = np.eye(4)
        placed[:3, :3] = data.xmat[part].reshape(3, 3)
        # A unit's frame is on the road below its origin.
        placed[:3, 3] = data.xpos[part] - [data.xpos[unit][0], 0.0, 0.0]
        scenes[unit].add_geometry(merge_geoms(model, drawn), transform=upright @ placed)
    return {
        unit.name: scenes[body].export(file_type="glb")
        for unit, body in zip(parameters.units, bodies, strict=True)
    }


def pictures(video: Path) -> Iterator[tuple[float, bytes]]:
    """Yields time [s] and JPEG of the pictures of a film, `PICTURE_RATE` a second.

    Raises:
      InputError: the film cannot be read.
    """
    import imageio_ffmpeg

    try:
        frames = imageio_ffmpeg.read_frames(str(video), pix_fmt="rgb24")
        about = next(frames)
        fps, size = float(about["fps"]), tuple(about["size"])
        every = max(round(fps / PICTURE_RATE), 1)
        for number, frame in enumerate(frames):
            if number % every == 0:
                content = io.BytesIO()
                picture = Image.frombytes("RGB", size, frame)
                picture.save(content, "JPEG", quality=_JPEG_QUALITY)
                yield number / fps, content.getvalue()
    except (OSError, RuntimeError, StopIteration) as error:
        raise InputError(f"film {str(video)!r} cannot be read: {error}") from error


def layout(units: tuple[str, ...], *, pictures: bool) -> str:
    """Returns the JSON of a Foxglove layout for a bag: scene, film, instruments, plots, decision.

    Args:
      units: names of the truck's units, whose frames are hidden.
      pictures: whether the bag has pictures of the film.
    """
    shown = {"visible": True}
    scene = {
        "cameraState": {
            "perspective": True,
            "distance": 45.0,
            "phi": 62.0,
            "thetaOffset": 90.0,
            "targetOffset": [-5.0, 0.0, 0.0],
            "target": [0.0, 0.0, 0.0],
            "targetOrientation": [0.0, 0.0, 0.0, 1.0],
            "fovy": 45.0,
            "near": 0.5,
            "far": 5000.0,
        },
        "followMode": "follow-pose",
        "followTf": units[0],
        "scene": {"backgroundColor": "#20262c"},
        "transforms": {f"frame:{name}": {"visible": False} for name in ("map", *units)},
        "topics": {
            "/vehicle/model": shown,
            "/traffic/markers": shown,
            "/planning/path": shown
            | {"type": "line", "lineWidth": 0.4, "gradient": ["#35d07f"] * 2},
        },
        "layers": {},
    }
    panels: dict[str, Any] = {
        "3D!scene": scene,
        "Plot!speed": _plot(
            "Speed [m/s]",
            ("/vehicle/state.speed", "speed"),
            ("/planning/trajectory.speed[0]", "planned"),
        ),
        "Plot!engine": _plot(
            "Pedal and demanded deceleration",
            ("/vehicle/command.accelerator_pedal", "accelerator pedal"),
            ("/vehicle/command.xbr_demand", "XBR demand [m/s2]"),
        ),
        "Plot!lateral": _plot(
            "Lateral motion",
            ("/vehicle/state.lateral_acceleration", "lateral acceleration [m/s2]"),
            ("/vehicle/state.articulation", "articulation [rad]"),
        ),
        "RawMessages!decision": {"topicPath": "/decision", "diffEnabled": False},
    }
    right = _column("Plot!speed", "Plot!engine", "Plot!lateral", "RawMessages!decision")
    left: Any = "3D!scene"
    if pictures:
        panels["Image!film"] = {"imageMode": {"imageTopic": "/camera/image/compressed"}}
        left = {"direction": "column", "first": left, "second": "Image!film", "splitPercentage": 60}
    arranged = {"direction": "row", "first": left, "second": right, "splitPercentage": 62}
    content = {
        "configById": panels,
        "globalVariables": {},
        "userNodes": {},
        "playbackConfig": {"speed": 1},
        "layout": arranged,
    }
    return json.dumps(content, indent=2) + "\n"


def _plot(title: str, *series: tuple[str, str]) -> dict[str, Any]:
    """Returns a panel with the values of message paths over time, each with its label."""
    paths = [
        {"value": path, "label": label, "enabled": True, "timestampMethod": "receiveTime"}
        for path, label in series
    ]
    return {
        "title": title,
        "paths": paths,
        "isSynced": True,
        "xAxisVal": "timestamp",
        "showLegend": True,
        "legendDisplay": "floating",
        "showXAxisLabels": True,
        "showYAxisLabels": True,
    }


def _column(first: str, *others: str) -> Any:
    """Returns panels of equal height, one above the other."""
    if not others:
        return first
    below, share = _column(*others), 100.0 / (1 + len(others))
    return {"direction": "column", "first": first, "second": below, "splitPercentage": share}
