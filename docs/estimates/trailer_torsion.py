"""Effect of trailer torsion on the roll-over threshold: a tilt table with a trailer in two halves.

`python docs/estimates/trailer_torsion.py` prints the table of docs/model.md.

The trailer is divided between kingpin and axles; a torsion spring at the height of the frame joins
the halves. The position of the centers of gravity between kingpin and bogie divides frame and load
among the halves, and each part lies above its own support. So static loads stay the same, and a
uniform twist does the same work.
"""

from __future__ import annotations

import math
import xml.etree.ElementTree as ET

import mujoco
import numpy as np

import iits_mj
from iits_mj.core.units import GRAVITY
from iits_mj.model.builder import truck_xml

FRAME_HEIGHT = 1.15  # [m] above the road, axis about which a ladder frame twists
TILT_RATE = math.radians(0.1)  # [rad/s] of the table
FALLING = math.radians(9.0)  # roll on the table beyond which the truck falls
KNM_PER_DEG = 1e3 * 180.0 / math.pi


def lump(inertial: ET.Element, share: float, position: float) -> ET.Element:
    """A share of an inertial, moved to `position` [m] behind the kingpin."""
    _, y, z = inertial.get("pos", "").split()
    inertia = [share * float(value) for value in inertial.get("diaginertia", "").split()]
    return ET.Element(
        "inertial",
        mass=str(share * float(inertial.get("mass", ""))),
        pos=f"{-position} {y} {z}",
        diaginertia=" ".join(map(str, inertia)),
    )


def in_two_halves(xml: str, parameters: iits_mj.TruckParameters, stiffness: float) -> str:
    """MJCF of the truck with the divided trailer; torsional stiffness [N m/rad]."""
    root = ET.fromstring(xml)
    trailer = root.find(".//body[@name='trailer']")
    assert trailer is not None
    bogie = float(np.mean([axle.position for axle in parameters.units[1].axles]))
    rear = ET.SubElement(trailer, "body", name="trailer_rear")
    height = FRAME_HEIGHT - parameters.couplings[0].height
    ET.SubElement(
        rear,
        "joint",
        name="trailer_torsion",
        type="hinge",
        axis="1 0 0",
        pos=f"0 0 {height}",
        stiffness=str(stiffness),
        damping="20e3",
    )
    load = trailer.find("body[@name='payload']")
    assert load is not None
    halves = ((trailer, rear), (load, ET.SubElement(rear, "body", name="payload_rear")))
    for front_body, rear_body in halves:
        whole = front_body.find("inertial")
        if whole is None:  # an empty truck has no load
            continue
        share = -float(whole.get("pos", "").split()[0]) / bogie
        front_body.remove(whole)
        front_body.append(lump(whole, 1.0 - share, 0.0))
        rear_body.append(lump(whole, share, bogie))
    for body in trailer.findall("body"):
        if body.get("name", "").startswith("trailer_axle"):
            trailer.remove(body)
            rear.append(body)
    return ET.tostring(root, encoding="unicode")


def threshold(payload: float, height: float | None, stiffness: float | None) -> float:
    """Static roll-over threshold [g] on a slow tilt table; stiffness None is the rigid trailer."""
    parameters = iits_mj.TruckParameters.load().with_payload_height(height)
    xml = truck_xml(parameters, payload)
    if stiffness is not None:
        xml = in_two_halves(xml, parameters, stiffness)
    model = mujoco.MjModel.from_xml_string(xml)
    model.opt.timestep = 0.004
    data = mujoco.MjData(model)
    data.ctrl[model.actuator("parking_brake").id] = 1.0
    halves = ["trailer"] if stiffness is None else ["trailer", "trailer_rear"]
    angle, block = math.atan(0.2), 0.1
    for _ in range(1000):
        model.opt.gravity[:] = 0.0, -GRAVITY * math.sin(angle), -GRAVITY * math.cos(angle)
        mujoco.mj_step(model, data)
    while True:
        angle += TILT_RATE * block
        model.opt.gravity[:] = 0.0, -GRAVITY * math.sin(angle), -GRAVITY * math.cos(angle)
        mujoco.mj_step(model, data, round(block / model.opt.timestep))
        for half in halves:
            attitude = data.body(half).xmat.reshape(3, 3)
            if abs(math.atan2(attitude[2, 1], attitude[2, 2])) > FALLING:
                return math.tan(angle)


def main() -> None:
    """Prints the table."""
    cases = ((36_000.0, None), (36_000.0, 2.8), (0.0, None))
    names = ("laden", "laden, load at 2.8 m", "empty")
    print(f"| torsional stiffness [kN m/deg] | {' | '.join(names)} |")
    print("|---|---|---|---|")
    rigid = [threshold(payload, height, None) for payload, height in cases]
    print(f"| rigid | {' | '.join(f'{value:.3f} g' for value in rigid)} |")
    for stiffness in (100.0, 30.0, 10.0, 5.0, 2.0):
        found = [threshold(*case, stiffness * KNM_PER_DEG) for case in cases]
        changes = [f"{100 * (new / old - 1):+.1f} %" for new, old in zip(found, rigid, strict=True)]
        print(f"| {stiffness:g} | {' | '.join(changes)} |")


if __name__ == "__main__":
    main()
