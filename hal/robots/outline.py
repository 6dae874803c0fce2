"""URDF of a robot whose folder brings none: its body as a box, its limbs as lines, its wheels or feet."""

from __future__ import annotations

from math import pi
from xml.etree import ElementTree as Xml

from hal.limbs import LEGS, SIGN_X, SIGN_Y
from hal.robots.robot import Robot

BOX_HEIGHT = 0.10
"""Of the body's box [m]."""
LIMB_RADIUS = 0.02
"""Radius of a limb [m]."""


def urdf(robot: Robot) -> str:
    """Its description for RViz, Foxglove and `robot_state_publisher`. Raises NamedError."""
    return str(robot.load(robot.description)()) if robot.description else outline(robot)


def outline(robot: Robot) -> str:
    """Links and joints with the names of `hal.limbs.MOTORS`; no inertia."""
    root = Xml.Element("robot", name=robot.name)
    trunk = Xml.SubElement(root, "link", name="base_link")
    limbs = robot.limbs
    _shape(trunk, "box", (0.0, 0.0, 0.0), size=f"{robot.body.length:.4g} {2 * limbs.hip_y:.4g} {BOX_HEIGHT}")
    for leg, sx, sy in zip(LEGS, SIGN_X.tolist(), SIGN_Y.tolist(), strict=True):
        places = (
            ("hip", (limbs.hip_x * sx, limbs.hip_y * sy, limbs.hip_z), "1 0 0"),
            ("thigh", (0.0, limbs.thigh_y * sy, 0.0), "0 1 0"),
            ("calf", (0.0, 0.0, -limbs.thigh), "0 1 0"),
            ("wheel", (0.0, 0.0, -limbs.calf), "0 1 0"),
        )
        parent = "base_link"
        for part, place, axis in places:
            name = f"{leg}_{part}"
            link = Xml.SubElement(root, "link", name=name)
            length = {"thigh": limbs.thigh, "calf": limbs.calf}.get(part, 0.0)
            if length > 0.0:
                _shape(link, "cylinder", (0.0, 0.0, -length / 2), radius=str(LIMB_RADIUS), length=str(length))
            if part == "wheel":
                tread = {"radius": str(limbs.radius), "length": str(limbs.tread_width)}
                _shape(link, "cylinder", (0.0, limbs.tread_y * sy, 0.0), roll=pi / 2, **tread)
            kind = "continuous" if name in robot.moves else "fixed"
            joint = Xml.SubElement(root, "joint", name=name, type=kind)
            Xml.SubElement(joint, "parent", link=parent)
            Xml.SubElement(joint, "child", link=name)
            Xml.SubElement(joint, "origin", xyz=" ".join(f"{v:.9g}" for v in place))
            Xml.SubElement(joint, "axis", xyz=axis)
            parent = name
    Xml.indent(root)
    return '<?xml version="1.0"?>\n' + Xml.tostring(root, encoding="unicode")


def _shape(
    link: Xml.Element, kind: str, centre: tuple[float, float, float], roll: float = 0.0, **size: str
) -> None:
    part = Xml.SubElement(link, "visual")
    Xml.SubElement(part, "origin", xyz=" ".join(f"{v:.9g}" for v in centre), rpy=f"{roll:.9g} 0 0")
    Xml.SubElement(Xml.SubElement(part, "geometry"), kind, size)
