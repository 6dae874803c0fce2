"""URDF of the Go2-W, written from the facts in `hal.robots.go2w.facts`: links, joints, limits, inertia, and boxes and
cylinders for shapes."""

from __future__ import annotations

import math
from xml.etree import ElementTree as Xml

from hal.robots.go2w import facts as go2w
from hal.robots.go2w.facts import Link

ROOT = "base_link"
GREY, DARK = "0.75 0.76 0.78 1", "0.15 0.15 0.16 1"


def urdf() -> str:
    """The description that RViz, Foxglove and `robot_state_publisher` read. Joints have the names of `go2w.MOTORS`."""
    robot = Xml.Element("robot", name="go2w")
    trunk = _link(robot, ROOT, go2w.BASE_LINK)
    _shape(trunk, "box", (0.0, 0.0, 0.0), GREY, size="0.376 0.0935 0.114")
    _shape(trunk, "cylinder", (0.285, 0.0, 0.01), GREY, radius="0.05", length="0.09")
    for leg, name in enumerate(go2w.LEGS):
        _leg(robot, name, float(go2w.SIGN_X[leg]), float(go2w.SIGN_Y[leg]))
    Xml.indent(robot)
    return '<?xml version="1.0"?>\n' + Xml.tostring(robot, encoding="unicode")


def _leg(robot: Xml.Element, name: str, sx: float, sy: float) -> None:
    hip = _link(robot, f"{name}_hip", go2w.HIP_LINK, sx, sy)
    _shape(hip, "cylinder", (0.0, 0.08 * sy, 0.0), GREY, along_y=True, radius="0.046", length="0.04")
    _joint(robot, f"{name}_hip", ROOT, (go2w.HIP_X * sx, go2w.HIP_Y * sy, 0.0), "1 0 0")

    thigh = _link(robot, f"{name}_thigh", go2w.THIGH_LINK, 1.0, sy)
    _shape(thigh, "box", (0.0, 0.0, -go2w.THIGH / 2), GREY, size=f"0.034 0.0245 {go2w.THIGH}")
    _joint(robot, f"{name}_thigh", f"{name}_hip", (0.0, go2w.THIGH_Y * sy, 0.0), "0 1 0")

    calf = _link(robot, f"{name}_calf", go2w.CALF_LINK, 1.0, sy)
    _shape(calf, "cylinder", (0.0, 0.0, -go2w.CALF / 2), DARK, radius="0.013", length=str(go2w.CALF))
    _joint(robot, f"{name}_calf", f"{name}_thigh", (0.0, 0.0, -go2w.THIGH), "0 1 0")

    motor = f"{name}_wheel_motor"
    _link(robot, motor, go2w.WHEEL_MOTOR, 1.0, sy)
    _connect(robot, motor, "fixed", f"{name}_calf", motor, (0.0, 0.0, 0.0))

    wheel = _link(robot, f"{name}_wheel", go2w.WHEEL_LINK, 1.0, sy)
    tread = {"radius": str(go2w.WHEEL_RADIUS), "length": str(go2w.TREAD_WIDTH)}
    _shape(wheel, "cylinder", (0.0, go2w.TREAD_Y * sy, 0.0), DARK, along_y=True, **tread)
    _joint(robot, f"{name}_wheel", f"{name}_calf", (0.0, 0.0, -go2w.CALF), "0 1 0")


def _link(robot: Xml.Element, name: str, facts: Link, sx: float = 1.0, sy: float = 1.0) -> Xml.Element:
    """A link of the leg at (sx, sy), mirrored from the front left one; products change sign with the mirrored axes."""
    link = Xml.SubElement(robot, "link", name=name)
    inertial = Xml.SubElement(link, "inertial")
    x, y, z = facts.com
    Xml.SubElement(inertial, "origin", xyz=_numbers(x * sx, y * sy, z))
    Xml.SubElement(inertial, "mass", value=str(facts.mass))
    xx, yy, zz, xy, xz, yz = facts.inertia
    values = {"ixx": xx, "iyy": yy, "izz": zz, "ixy": xy * sx * sy, "ixz": xz * sx, "iyz": yz * sy}
    Xml.SubElement(inertial, "inertia", {key: f"{value:.9g}" for key, value in values.items()})
    return link


def _shape(
    link: Xml.Element,
    kind: str,
    centre: tuple[float, float, float],
    colour: str,
    *,
    along_y: bool = False,
    **size: str,
) -> None:
    for purpose in ("visual", "collision"):
        part = Xml.SubElement(link, purpose)
        turn = _numbers(math.pi / 2 if along_y else 0.0, 0.0, 0.0)
        Xml.SubElement(part, "origin", xyz=_numbers(*centre), rpy=turn)
        Xml.SubElement(Xml.SubElement(part, "geometry"), kind, size)
        if purpose == "visual":
            material = Xml.SubElement(part, "material", name="grey" if colour == GREY else "dark")
            Xml.SubElement(material, "color", rgba=colour)


def _joint(robot: Xml.Element, motor: str, parent: str, place: tuple[float, float, float], axis: str) -> None:
    """The joint of a motor; its child link has the motor's name."""
    number = go2w.MOTORS.index(motor)
    low, high = go2w.JOINT_RANGE[number]
    free = not math.isfinite(low)
    joint = _connect(robot, motor, "continuous" if free else "revolute", parent, motor, place)
    Xml.SubElement(joint, "axis", xyz=axis)
    limit = {"effort": str(go2w.TORQUE_LIMIT[number]), "velocity": str(go2w.SPEED_LIMIT[number])}
    Xml.SubElement(joint, "limit", limit if free else limit | {"lower": str(low), "upper": str(high)})
    Xml.SubElement(joint, "dynamics", damping=str(go2w.JOINT_DAMPING), friction=str(go2w.JOINT_FRICTION))


def _connect(
    robot: Xml.Element, name: str, kind: str, parent: str, child: str, place: tuple[float, float, float]
) -> Xml.Element:
    joint = Xml.SubElement(robot, "joint", name=name, type=kind)
    Xml.SubElement(joint, "parent", link=parent)
    Xml.SubElement(joint, "child", link=child)
    Xml.SubElement(joint, "origin", xyz=_numbers(*place))
    return joint


def _numbers(*values: float) -> str:
    return " ".join(f"{value:.9g}" for value in values)
