"""Frames of legs and wheels from the joint angles: what `robot_state_publisher` does where ROS runs."""

from __future__ import annotations

import math
from xml.etree import ElementTree as Xml

from rbtrg_robot import msg
from rbtrg_robot.wire.convert import transform_msg
from rbtrg_robot.wire.messages import stamp_of


class Legs:
    """The joints of a URDF."""

    def __init__(self, description: str) -> None:
        """`description`: the URDF as text."""
        self._joints = [
            (joint.attrib["name"], *_ends(joint), _axis(joint))
            for joint in Xml.fromstring(description).iter("joint")
        ]

    def frames(self, joints: msg.JointState) -> msg.TFMessage:
        """tf2_msgs/TFMessage of every link in its parent; a joint without an angle stands at zero."""
        angles = dict(zip(joints.name, joints.position.tolist(), strict=False))
        stamp = stamp_of(joints)
        transforms = []
        for name, parent, child, place, axis in self._joints:
            half = angles.get(name, 0.0) / 2
            turn = (*(math.sin(half) * part for part in axis), math.cos(half))
            transforms.append(transform_msg(stamp, parent, child, place, turn))
        return msg.TFMessage(transforms=transforms)


def _ends(joint: Xml.Element) -> tuple[str, str, tuple[float, ...]]:
    """Parent, child, and where the child begins [m]; our joints do not turn their frames."""
    parent, child, origin = (joint.find(tag) for tag in ("parent", "child", "origin"))
    assert parent is not None
    assert child is not None
    assert origin is not None
    return parent.attrib["link"], child.attrib["link"], _numbers(origin.attrib["xyz"])


def _axis(joint: Xml.Element) -> tuple[float, ...]:
    axis = joint.find("axis")
    return (0.0, 0.0, 0.0) if axis is None else _numbers(axis.attrib["xyz"])


def _numbers(text: str) -> tuple[float, ...]:
    return tuple(float(word) for word in text.split())
