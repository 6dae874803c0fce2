"""Messages as the page reads them: JSON for what is small, bytes for terrain and points. Pure.

A frame is one binary WebSocket message: a byte for its kind (JSON, TERRAIN, POINTS, AGES, PICTURE), three of zero, the
content.
"""

from __future__ import annotations

import json
import math
import re
from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rbtrg_robot import msg
from rbtrg_robot import topics as t
from rbtrg_robot.areas import plain as plain_areas
from rbtrg_robot.missions.file import describe
from rbtrg_robot.missions.words import line
from rbtrg_robot.orders.words import held, slowed
from rbtrg_robot.stages.navigation.goal import arrival
from rbtrg_robot.stages.navigation.reasons import hindrance, words
from rbtrg_robot.topics import Topic
from rbtrg_robot.wire.convert import xyz, xyzw, yaw_of
from rbtrg_robot.wire.frames import MapFrame
from rbtrg_robot.wire.messages import stamp_of

JSON, TERRAIN, POINTS, AGES, PICTURE = 1, 2, 3, 4, 5
COMMAND = re.compile(r"[;:,]? *`rbtrg-robot (?:resume|posture|mission)[^`]*`[^;)]*")
POINTS_MOST = 6000
"""Of one frame."""


def pack(kind: str, content: dict[str, Any]) -> bytes:
    """A JSON frame; numbers that are not finite become null."""
    text = json.dumps({"kind": kind, **finite(content)}, separators=(",", ":"), allow_nan=False)
    return bytes((JSON, 0, 0, 0)) + text.encode()


def finite(value: Any) -> Any:
    """As JSON holds it: numbers that are not finite become None, the others are rounded to 0.0001."""
    if isinstance(value, dict):
        return {key: finite(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [finite(item) for item in value]
    if isinstance(value, np.ndarray):
        return finite(value.tolist())
    if isinstance(value, float | np.floating):
        return round(float(value), 4) if math.isfinite(value) else None
    return value.item() if isinstance(value, np.generic) else value


def lens(message: msg.CameraInfo) -> dict[str, Any]:
    """What a page projects with: size [pixels], focal length and centre [pixels]."""
    fx, _, cx, _, fy, cy = message.k[:6].tolist()
    return {
        "width": int(message.width),
        "height": int(message.height),
        "fx": fx,
        "fy": fy,
        "cx": cx,
        "cy": cy,
    }


def picture(message: msg.CompressedImage, facts: dict[str, Any]) -> bytes:
    """A PICTURE frame: length of the JSON `facts` in four bytes, little-endian, the facts, the JPEG."""
    text = json.dumps(finite(facts), separators=(",", ":"), allow_nan=False).encode()
    return bytes((PICTURE, 0, 0, 0)) + len(text).to_bytes(4, "little") + text + message.data.tobytes()


def pose(message: msg.Odometry, frame: MapFrame, correction: float) -> dict[str, Any]:
    """base_link in `map`: x, y, z [m], quaternion, heading [rad], speed [m/s, rad/s]. `correction` as in MapStatus
    [m]."""
    place, turn = frame.pose3(xyz(message.pose.pose.position), xyzw(message.pose.pose.orientation))
    twist = message.twist.twist
    yaw = math.remainder(yaw_of(message.pose.pose.orientation) + frame.yaw, 2 * math.pi)
    x, y, z = place
    return {
        "x": x,
        "y": y,
        "z": z + correction,
        "q": turn.tolist(),
        "yaw": yaw,
        "v": twist.linear.x,
        "w": twist.angular.z,
    }


def robot(message: msg.RobotState) -> dict[str, Any]:
    """State, stop, battery and why it does not move, in the words of the commands."""
    why = hindrance(message)
    return {
        "phase": message.phase,
        "cause": message.cause,
        "estop": bool(message.estop),
        "estop_cause": message.estop_cause,
        "latch": str(message.latch),
        "taken": message.taken,
        "held": here(held(message.hold)),
        "hindrance": here(words(*why)) if why else "",
        "battery": message.battery,
        "motor_temperature": message.motor_temperature,
        "contact": [bool(x) for x in message.contact],
        "vx": message.vx,
        "wz": message.wz,
        "refused": dict(zip(message.refused_reason, message.refused_count.tolist(), strict=True)),
        "realtime_factor": message.realtime_factor,
        "seen": str(stamp_of(message)),
        "hands": message.hands,
    }


def here(text: str) -> str:
    """Words without the commands for which the page has buttons."""
    return COMMAND.sub("", text)


def goal(message: msg.GoalStatus) -> dict[str, Any]:
    """The newest goal and how it stands."""
    return {
        "id": message.id,
        "owner": message.owner,
        "state": message.state,
        "reason": message.reason,
        "words": here(words(message.reason, message.detail)),
        "x": message.x,
        "y": message.y,
        "yaw": message.yaw if message.has_yaw else None,
        "left": message.distance_left,
        "replans": int(message.replans),
        "recoveries": int(message.recoveries),
        "risk": message.risk,
        "frontier": bool(message.frontier),
        "chance": message.chance_change or arrival(message.p_fail, message.worst),
    }


def route(message: msg.RouteReport) -> dict[str, Any]:
    """A route and why it is this one; the arrays as they are named in the message."""
    names = (
        *(
            "id",
            "ok",
            "reaches_goal",
            "cost",
            "length",
            "duration",
            "p_fail",
            "x",
            "y",
            "z",
            "yaw",
            "node_x",
            "node_y",
            "node_z",
        ),
        *(f"transition_{name}" for name in ("length", "cost", "turn", "risk", "body", "unknown", "p_fail")),
        *(
            "d_fb",
            "a_lr",
            "p_int",
            "worst_x",
            "worst_y",
            "worst_yaw",
            "native_x",
            "native_y",
            "native_length",
        ),
        *("native_body", "graph_x", "graph_y", "graph_z", "graph_from", "graph_to", "graph_risk"),
    )
    return {
        "words": words(message.reason, message.detail),
        "chance": arrival(message.p_fail, message.worst),
        **{name: getattr(message, name) for name in names},
    }


def mission(message: msg.MissionState) -> dict[str, Any]:
    """How far the mission is."""
    names = ("order_id", "name", "phase", "reason", "step", "question", "choices", "action_status")
    home = {"x": message.home_x, "y": message.home_y, "yaw": message.home_yaw}
    return {
        "words": line(message),
        "home": home if message.has_home else None,
        "results": message.result_description,
        **{name: getattr(message, name) for name in names},
    }


def mission_order(order: msg.MissionOrder) -> dict[str, Any]:
    """The steps of a mission, as they are drawn and listed."""
    steps = [
        {
            "id": step.id,
            "step": step.kind,
            "words": describe(step),
            **(
                {"x": step.x, "y": step.y, "yaw": step.yaw if step.has_yaw else None}
                if step.kind == "goto"
                else {}
            ),
        }
        for step in order.steps
    ]
    loops = [[int(loop.first), int(loop.last), int(loop.times)] for loop in order.loops]
    names = ("order_id", "name", "on_comms_loss", "comms_timeout")
    return {"steps": steps, "loops": loops, **{name: getattr(order, name) for name in names}}


def limits(message: msg.MotionLimits) -> dict[str, Any]:
    """What the guard lets through, and why no more."""
    names = ("forward", "backward", "left", "right")
    return {**{name: getattr(message, name) for name in names}, "slowed": slowed(message.reason)}


def plain(*names: str) -> Callable[[Any], dict[str, Any]]:
    """The named fields as they are."""
    return lambda message: {name: getattr(message, name) for name in names}


PLAIN: dict[Topic, tuple[str, Callable[[Any], dict[str, Any]]]] = {
    t.ROBOT_STATE: ("robot", robot),
    t.GOAL_STATUS: ("goal", goal),
    t.MISSION_STATE: ("mission", mission),
    t.MISSION_ORDER: ("mission_order", mission_order),
    t.AREAS: ("areas", lambda message: {"areas": plain_areas(message.areas)}),
    t.ODOM_HEALTH: ("odometry", plain("health", "reason", "overlap", "inliers", "residual", "degeneracy")),
    t.MAP_STATUS: (
        "map",
        plain(
            *("epoch", "known_cells", "trusted_cells", "resolution", "restoring", "warning", "detail"),
            *("location", "location_detail", "candidates"),
        ),
    ),
    t.TRACKER_STATE: (
        "tracker",
        plain("phase", "hold", "slow", "distance_left", "cross_track", "heading_error"),
    ),
    t.MOTION_LIMITS: ("limits", limits),
    t.ROUTE_STATUS: ("route_status", plain("valid", "detail", "nodes", "edges", "map_version")),
}
"""Topics of which a page gets one kind of JSON frame each."""
LEAST: dict[Topic, float] = {
    t.ODOM: 0.08,
    t.ROBOT_STATE: 0.08,
    t.GOAL_STATUS: 0.0,
    t.ODOM_HEALTH: 0.4,
    t.MAP_STATUS: 0.4,
    t.TRACKER_STATE: 0.2,
    t.MOTION_LIMITS: 0.2,
    t.ROUTE_STATUS: 0.4,
    t.CLOUD: 0.19,
}
"""Seconds between two frames of a topic; a change of the robot's state is told at once all the same."""


def points(cloud: NDArray[np.float32], place: NDArray[np.float64], turn: NDArray[np.float64]) -> bytes:
    """float32[7] position and quaternion of base_link in `map`, then int16[n, 3] points in base_link [mm]. `cloud` (n,
    3) [m]."""
    chosen = cloud[:: max(1, len(cloud) // POINTS_MOST + (len(cloud) % POINTS_MOST > 0))]
    chosen = chosen[np.isfinite(chosen).all(axis=1) & (np.abs(chosen) < 32.0).all(axis=1)]
    head = np.concatenate([place, turn]).astype("<f4").tobytes()
    return bytes((POINTS, 0, 0, 0)) + head + (chosen * 1000.0).astype("<i2").tobytes()


def terrain(content: bytes) -> bytes:
    """A frame of `Terrain.newer`."""
    return bytes((TERRAIN, 0, 0, 0)) + content


def ages(content: bytes) -> bytes:
    """A frame of `Terrain.ages`."""
    return bytes((AGES, 0, 0, 0)) + content
