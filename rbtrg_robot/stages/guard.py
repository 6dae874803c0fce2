"""The guard: how fast the body may move where it stands, from the newest map window and sweep. It knows no goal and no
plan.

The field calls it a collision monitor. The safety gate applies its limits to every motion, whoever asked for it.
"""

from __future__ import annotations

import math
from collections import OrderedDict
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hal.limbs import Limbs
from hal.rotation import rotation
from hal.safety.contact import contact_at
from hal.safety.monitors import GUARD_BLIND, HOLE_WIDTH, MAIN_SILENT
from hal.safety.swept import (
    BODY_CLEARANCE,
    HOLE,
    LEAST_POINTS,
    LIDAR,
    NO_WALL,
    PLANTS,
    TOUCHED,
    TRACK_SPACING,
    WHEELS,
    Body,
    Reach,
    Surroundings,
    leaves_on,
    occupy,
    reach_of,
    shells,
    stand_of,
    straight_tracks,
    turn_step,
    turn_tracks,
)
from hal.safety.touch import near_body, uneven
from hal.types import NO_POINTS, NS, Array, Capabilities, MountedLidar
from mapping.filling import fill_unknown
from rbtrg_robot import msg
from rbtrg_robot import topics as t
from rbtrg_robot.config import StackConfig
from rbtrg_robot.stage_config import GUARD_RANGE, GuardConfig
from rbtrg_robot.stages.stage import Outputs
from rbtrg_robot.topics import Topic
from rbtrg_robot.wire.convert import (
    BASE,
    LayoutError,
    cloud_points,
    joint_sample,
    map_patch,
    xyz,
    xyzw,
    yaw_of,
)
from rbtrg_robot.wire.frames import MapFrame, Planar
from rbtrg_robot.wire.messages import header, stamp_of

POINTS_AROUND = 2.0
"""[m] from base_link: points of a sweep beyond are of no interest."""
CREEP_SPEED, CREEP_TURN = 0.2, 0.3
"""[m/s], [rad/s] along a wall that the body touches."""
MOST_LEAN = math.radians(25.0)
"""[rad] A robot that leans by more than this goes nowhere along a wall: one that was let go on at 30 deg came to 40 to
50 deg in each of six drives."""
LEAF_SPEEDS = (0.2, 0.5)
"""[m/s] and [rad/s] of a turn, 0.2 m/s at a corner of the body, over ground under leaves: what stands in them is felt,
not seen."""
STANDING_HEIGHT = 0.05
"""[m] above a step that points must be to count as something that stands there: noise of map and pose."""
WORDS = {
    1: "a {:.2f} m face",
    2: "a {:.2f} m drop",
    3: "something the last sweep saw",
    4: "ground nobody saw",
    5: HOLE_WIDTH.words,
}


class GuardStage:
    """Map window and sweeps in, the speeds that are safe here out.

    In: the window of the elevation map, the newest sweep, poses, joints, tf_static, the map's status. Out:
    `/guard/limits`, the largest speed forward, backward and in each turn, 20 times a second. It decides how far the
    body may move before it meets a face, a drop or something that stands there. It knows no goal and no plan, and it
    never moves the robot.
    """

    outputs = (t.MOTION_LIMITS,)

    def __init__(
        self, params: GuardConfig, robot: Capabilities, limbs: Limbs, lidars: tuple[MountedLidar, ...]
    ) -> None:
        """lidars: whose sweeps it hears."""
        self._sweeps = tuple(t.CLOUDS[lidar.name] for lidar in lidars)
        self.inputs = (t.MAP_WINDOW, *self._sweeps, t.ODOM, t.POSE, t.JOINTS, t.TF_STATIC, t.MAP_STATUS)
        self._params = params
        self._robot = robot
        self._body = Body.of(robot)
        self._limbs = limbs
        self._joints: Array | None = None
        """(16,) the newest angles [rad]."""
        self._frame = MapFrame()
        self._now = 0
        self._pose: msg.Odometry | None = None
        self._clouds: OrderedDict[int, dict[Topic, NDArray[np.float32]]] = OrderedDict()
        """By stamp, those of all LiDARs."""
        self._seen: dict[Topic, int] = {}
        """Stamp of the newest sweep with a point, as far as it is not ahead of the clock [ns]."""
        self._began: int | None = None
        """The first tick [ns]."""
        self._odoms: OrderedDict[int, msg.Odometry] = OrderedDict()
        self._correction = 0.0
        self._around: Surroundings | None = None
        self._filled: NDArray[np.float32] = np.zeros((1, 1), np.float32)
        self._lowest: NDArray[np.float32] = np.zeros((1, 1), np.float32)
        """[m] above the ground that points must be to count: in leaves, above the leaves."""
        self._stamp = 0
        self._laid = True
        """Nothing came since the newest sweep was laid over the window."""
        self._dark = False
        """The window has no known ground, by whose height is told what stands on it."""
        self._malformed = 0
        self._ahead = round(params.pose_timeout * NS)
        p = params
        around = robot.max_wz * p.reaction + robot.max_wz**2 / (2 * robot.max_alpha) + self._turn_margin
        ways: tuple[tuple[str, Callable[[Body, Body | None], Array], float], ...] = (
            ("ahead", partial(straight_tracks, GUARD_RANGE, 1.0), TRACK_SPACING),
            ("behind", partial(straight_tracks, GUARD_RANGE, -1.0), TRACK_SPACING),
            ("to the left", partial(turn_tracks, around, 1.0), turn_step(self._body)),
            ("to the right", partial(turn_tracks, around, -1.0), turn_step(self._body)),
        )
        self._ways = [(where, tracks, tracks(self._body, None), step) for where, tracks, step in ways]

    @property
    def _turn_margin(self) -> float:
        """[rad] that keeps the corners of the body `margin` away."""
        return self._params.margin * turn_step(self._body) / TRACK_SPACING

    def warm_up(self) -> None:
        """Compile the kernels."""
        flat = np.zeros((3, 3), np.float32)
        flat[2, 1] = 1.0  # a wall at its side
        free = np.zeros((3, 3), np.uint8)
        unknown, certain = np.full_like(flat, np.nan), np.zeros_like(flat)
        around = Surroundings(flat, unknown, free, free.copy(), certain, (-0.2, -0.2), 0.2)
        fill_unknown(flat, around.bound)
        here = (0.0, 0.0, 0.0)
        stand = stand_of(around, here, np.array([0.0, 0.0, 1.0]), self._body)
        contact = contact_at(around, here, stand, self._robot)
        wall = NO_WALL if contact is None else contact.wall
        for _, tracks, whole, step in self._ways:
            reach_of(whole, step, around, here, stand, self._robot, seen=False)
            swept = shells(tracks, self._body, self._body)
            reach_of(swept, step, around, here, stand, self._robot, seen=False, wall=wall)
            leaves_on(whole, step, replace(around, source=np.full_like(free, PLANTS)), here, self._body)
        angles = np.zeros(16)
        angles.setflags(write=False)  # as a message has them
        near_body(around, here, np.eye(3), self._limbs, angles, self._body)
        self._mark(around, np.zeros((1, 3)) @ rotation(np.array([0.0, 0.0, 0.0, 1.0])).T, flat, flat)

    def close(self) -> None:
        """Nothing to release."""

    def on(self, topic: Topic, message: Any) -> Outputs:
        """Take one message."""
        if t.POSE.carried(message, topic):
            self._pose = message
        elif t.TF_STATIC.carried(message, topic):
            if self._frame.take(message):
                self._around = None  # it lay elsewhere
        elif t.MAP_STATUS.carried(message, topic):
            if math.isfinite(message.height_correction):
                self._correction = message.height_correction
        elif t.ODOM.carried(message, topic):
            self._keep(self._odoms, stamp_of(message), message)
        elif topic in self._sweeps:
            self._cloud(topic, message)
        elif t.JOINTS.carried(message, topic):
            self._joints = self._angles(message)
        elif t.MAP_WINDOW.carried(message, topic):
            self._window(message)
        return []

    def _cloud(self, topic: Topic, message: msg.PointCloud2) -> None:
        stamp = stamp_of(message)
        try:
            points = cloud_points(message)
        except LayoutError:
            self._malformed += 1
            return
        self._keep(self._clouds, stamp, {**self._clouds.get(stamp, {}), topic: points})

    def _angles(self, message: msg.JointState) -> Array | None:
        try:
            return joint_sample(message).position
        except LayoutError:
            self._malformed += 1
            return self._joints

    def _keep(self, kept: OrderedDict[int, Any], stamp: int, what: Any) -> None:
        """With the newest of its kind: a pose may come before the cloud of its scan, or after it."""
        kept[stamp] = what
        if len(kept) > 20:
            kept.popitem(last=False)
        self._laid = False

    def _window(self, message: msg.GridMap) -> None:
        try:
            patch = map_patch(message, 0)
        except LayoutError:
            self._malformed += 1
            return
        height, upper = patch.layers["elevation"], patch.layers["upper_bound"]
        source = patch.layers["source"]
        unknown = np.isnan(height)
        self._dark = bool(unknown.all())
        self._filled = fill_unknown(height, upper)
        self._around = Surroundings(
            np.where(patch.layers["trusted"] > 0.5, height, np.float32(np.nan)),
            np.where(unknown, upper, np.float32(np.nan)),
            np.where(np.isin(source, (WHEELS, LIDAR, PLANTS, TOUCHED, HOLE)), source, 0).astype(np.uint8),
            np.zeros(height.shape, np.uint8),
            np.where(source == LIDAR, patch.layers["variance"], np.float32(0.0)),
            patch.origin,
            patch.resolution,
        )
        lowest = np.float32(self._robot.max_step + STANDING_HEIGHT)
        leaves = upper - height + np.float32(STANDING_HEIGHT)
        self._lowest = np.where(source == PLANTS, np.maximum(leaves, lowest), lowest)
        self._stamp = patch.stamp
        self._laid = False

    def _sweep(self, *, main: bool) -> None:
        """Lay the newest sweep whose pose is known over the window, once for all that came since the last time. `main`:
        the main LiDAR speaks."""
        if self._laid:
            return
        self._laid = True
        # One that is stamped ahead of the clock would hide all that come after it.
        both = [x for x in self._clouds.keys() & self._odoms.keys() if x <= self._now + self._ahead]
        if not both or self._around is None or not self._frame.known:
            return
        newest = max(both)
        if newest < self._stamp:
            return
        # Head sweeps replace main sweeps only: 2 cm beside a wall the noise of an L1 would hold the robot, and the
        # map has what the head sees.
        clouds = self._clouds[newest]
        points = clouds.get(t.CLOUD, NO_POINTS) if main else np.concatenate([NO_POINTS, *clouds.values()])
        x, y = points[:, 0], points[:, 1]
        near = points[np.flatnonzero(np.maximum(np.abs(x), np.abs(y)) < POINTS_AROUND)].astype(np.float64)
        pose = self._odoms[newest].pose.pose
        position, orientation = self._frame.pose3(xyz(pose.position), xyzw(pose.orientation))
        place = position + np.array([0.0, 0.0, self._correction])
        self._mark(self._around, near @ rotation(orientation).T + place, self._filled, self._lowest)

    def _mark(
        self,
        around: Surroundings,
        points: NDArray[np.float64],
        ground: NDArray[np.float32],
        lowest: NDArray[np.float32],
    ) -> None:
        origin, resolution = around.origin, around.resolution
        occupy(points, ground, *origin, resolution, lowest, BODY_CLEARANCE, LEAST_POINTS, around.occupied)

    def tick(self, now: int) -> Outputs:
        """The limits of now."""
        self._now = now
        self._began = now if self._began is None else self._began
        self._look()
        missing = self._missing()
        if missing:
            return [(t.MOTION_LIMITS, msg.MotionLimits(header=header(now, BASE), reason=missing))]
        assert self._around is not None
        here, height, orientation = self._place()
        slow_by_sight = self._main_silent()
        self._sweep(main=not slow_by_sight)
        turned = rotation(orientation)
        stand = stand_of(self._around, here, turned[:, 2], self._body)
        reaches = [
            reach_of(whole, step, self._around, here, stand, self._robot, seen=k == 1)
            for k, (_, _, whole, step) in enumerate(self._ways)
        ]
        held = any(
            self._speed(r, turning=k > 1) < (CREEP_TURN if k > 1 else CREEP_SPEED)
            for k, r in enumerate(reaches)
        )
        upright = turned[2, 2] >= math.cos(MOST_LEAN)
        contact = contact_at(self._around, here, stand, self._robot) if held and upright else None
        speeds, words = [], [slow_by_sight] if slow_by_sight else []
        for k, (where, tracks, whole, step) in enumerate(self._ways):
            turning, behind, reach = k > 1, k == 1, reaches[k]
            most = self._robot.max_wz if turning else self._robot.max_vx
            speed = min(self._speed(reach, turning=turning), most)
            free = f"{math.degrees(reach.free):.0f} deg" if turning else f"{reach.free:.2f} m"
            why = f"{WORDS[reach.kind].format(reach.height)} {free} {where}" if speed < most else ""
            creeping = CREEP_TURN if turning else CREEP_SPEED
            if contact is not None and speed < creeping:
                # Beside a wall it is as straight as a cell of the map lets it be.
                body = contact.body if turning else contact.between(self._around.resolution)
                reach = reach_of(
                    shells(tracks, self._body, body),
                    step,
                    self._around,
                    here,
                    stand,
                    self._robot,
                    seen=behind,
                    wall=contact.wall,
                )
                slow = min(self._speed(reach, turning=turning), creeping)
                if slow > speed:
                    speed, why = slow, f"a wall that the body touches {where}"
            leaves = leaves_on(whole, step, self._around, here, self._body)
            slow = max(LEAF_SPEEDS[turning], self._stops_in(leaves, turning=turning))
            if slow < speed:
                speed, why = slow, f"grass {where}"
            speeds.append(min(speed, creeping) if slow_by_sight else speed)
            words += [why] if why else []
        ahead, back = uneven(self._around, here, self._body)
        place = (here[0], here[1], height)
        limits = msg.MotionLimits(
            header=header(now, BASE),
            forward=speeds[0],
            backward=speeds[1],
            left=speeds[2],
            right=speeds[3],
            reason="; ".join(words),
            uneven_ahead=ahead,
            uneven_behind=back,
            near_body=self._joints is not None
            and near_body(self._around, place, turned, self._limbs, self._joints, self._body),
        )
        return [(t.MOTION_LIMITS, limits)]

    def _speed(self, reach: Reach, *, turning: bool) -> float:
        """The speed [m/s or rad/s] from which the body stops within the reach; infinite where nothing is in the way."""
        if not reach.kind:
            return math.inf
        return self._stops_in(reach.free, turning=turning)

    def _stops_in(self, free: float, *, turning: bool) -> float:
        """The speed [m/s or rad/s] from which the body stops within `free` [m or rad]."""
        p = self._params
        rate = self._robot.max_alpha if turning else p.deceleration
        left = free - (self._turn_margin if turning else p.margin)
        return rate * (math.sqrt(p.reaction**2 + 2.0 * left / rate) - p.reaction) if left > 0.0 else 0.0

    def _missing(self) -> str:
        """The input that the guard lacks; empty when it sees."""
        if not self._frame.known:
            return f"no {t.TF_STATIC.name} yet"
        seen = self._unseen(*self._sweeps)
        blind = GUARD_BLIND.tell(age=self._told(seen)) if GUARD_BLIND.outside(seen) else ""
        for topic, stamp, limit in (
            (t.MAP_WINDOW, self._stamp if self._around else None, self._params.window_timeout),
            (t.POSE, stamp_of(self._pose) if self._pose else None, self._params.pose_timeout),
        ):
            if stamp is None:
                return f"no {topic.name} yet"
            age = (self._now - stamp) / NS
            if abs(age) > limit:  # without sweeps the map ends as well
                return blind or f"{topic.name} is {age:.1f} s old"
        if blind:
            return blind
        assert self._around is not None
        if self._dark:
            return "the map knows no ground around the robot"
        here, _, orientation = self._place()
        if not np.isfinite((*here, *orientation)).all() or not self._around.holds(*here[:2]):
            # Beyond the window nothing is known, and ground that nobody saw does not stop a robot that drives forward.
            return f"{t.POSE.name} lies outside of {t.MAP_WINDOW.name}"
        return ""

    def _look(self) -> None:
        """An empty sweep says that nothing came, one that is stamped ahead of the clock nothing at all."""
        latest = self._now + self._ahead
        self._seen = {topic: stamp for topic, stamp in self._seen.items() if stamp <= latest}
        for stamp, clouds in self._clouds.items():
            for topic, points in clouds.items():
                if stamp <= latest and len(points):
                    self._seen[topic] = max(stamp, self._seen.get(topic, stamp))

    def _unseen(self, *topics: Topic) -> float:
        """Seconds since the newest sweep with a point on any of these; infinite where none ever came."""
        return min(((self._now - self._seen[x]) / NS for x in topics if x in self._seen), default=math.inf)

    def _told(self, age: float) -> str:
        """Of a sweep, in words [s]."""
        assert self._began is not None
        return f"{age:.1f}" if math.isfinite(age) else f"more than {(self._now - self._began) / NS:.1f}"

    def _main_silent(self) -> str:
        """Why it is slow: the head's LiDAR looks ahead, and nobody sees who comes from the side; empty where the main
        one speaks."""
        age = self._unseen(t.CLOUD)
        return MAIN_SILENT.tell(age=self._told(age)) if MAIN_SILENT.outside(age) else ""

    def _place(self) -> tuple[Planar, float, NDArray[np.float64]]:
        """x, y [m], yaw [rad] of the robot in `map`, its height [m], and its orientation x, y, z, w."""
        assert self._pose is not None
        pose = self._pose.pose.pose
        here = self._frame.pose2(pose.position.x, pose.position.y, yaw_of(pose.orientation))
        position, orientation = self._frame.pose3(xyz(pose.position), xyzw(pose.orientation))
        return here, float(position[2]) + self._correction, orientation


def build(config: StackConfig) -> GuardStage:
    """From the stack's configuration."""
    # What the operator forbids to drive over is in the way, whatever the robot could climb.
    robot = replace(config.capabilities(), max_step=config.graph_params().max_step)
    return GuardStage(config.guard, robot, config.facts.limbs, config.mounted_lidars())
