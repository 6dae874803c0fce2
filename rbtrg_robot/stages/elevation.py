"""Elevation mapping as a stage: registered scans and wheel contacts in, changed blocks of the map out."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hal.limbs import Limbs, stand_height
from hal.robots import describe
from hal.safety.geofence import GeofenceError
from hal.types import NO_POINTS, JointSample, MountedLidar
from mapping.elevation.exchange import MapError
from mapping.elevation.export import Limits, traversal_cost
from mapping.elevation.files import checked_cloud
from mapping.elevation.map import AT_A_TIME, ElevationMap
from mapping.elevation.mirror import WHOLE_CELLS
from mapping.elevation.poses import Course
from mapping.elevation.sensor import Sensor
from mapping.odometry.contacts import wheel_contacts
from mapping.relocalise import warm_up
from mapping.relocalise.door import OURS, OwnFinder
from rbtrg_robot import msg
from rbtrg_robot import topics as t
from rbtrg_robot.areas import fence_of, read_areas
from rbtrg_robot.config import StackConfig
from rbtrg_robot.provenance import fingerprint
from rbtrg_robot.stage_config import ElevationStageConfig
from rbtrg_robot.stages.closing import Closing, target_of, until_of
from rbtrg_robot.stages.handover import Handover, possible
from rbtrg_robot.stages.location import Location, State
from rbtrg_robot.stages.map_blocks import MapBlocks
from rbtrg_robot.stages.navigation.reasons import LOCATED
from rbtrg_robot.stages.prior import Prior
from rbtrg_robot.stages.scans import Scan, Scans, rehearsal
from rbtrg_robot.stages.stage import Outputs
from rbtrg_robot.topics import Topic
from rbtrg_robot.wire.convert import (
    MAP,
    LayoutError,
    cloud_msg,
    cloud_points,
    cost_msg,
    joint_sample,
    map_parts,
    map_patch,
    patch_msg,
    xyz,
    xyzw,
    yaw_of,
)
from rbtrg_robot.wire.frames import MapFrame, Planar, stands
from rbtrg_robot.wire.messages import decode, encode, header, stamp_of

SILENT_SCANS = 5
"""Scans without a point of a LiDAR after which it counts as silent."""
STATUS_PERIOD = 500_000_000
"""[ns]"""
COST_REACH = 10.0
"""[m] Half width of the ground around the robot of which `MAP_COST` tells."""


class ElevationStage:
    """Registered scans in, the elevation map out. In: poses at the end of each scan, deskewed clouds of every LiDAR,
    joints, tf_static, requests for the map, another prior map, where an operator says that the robot stands. Out:
    changed blocks, the window around the robot, the whole map on request, status; what the ground costs, while somebody
    listens. It never plans, never moves the robot
    and writes no file.
    """

    outputs = (
        *(t.MAP_UPDATE, t.MAP_WINDOW, t.MAP_COST, t.MAP_CLOUD, t.MAP_FULL, t.MAP_PARTS, t.MAP_STATUS),
        t.AREAS,
    )
    shown = t.MAP_COST

    def __init__(
        self,
        elevation: ElevationMap,
        params: ElevationStageConfig,
        lidars: tuple[MountedLidar, ...],
        prior: str = "",
        start: Planar = (0.0, 0.0, 0.0),
        name: str = "",
        later: Callable[[], ElevationMap] | None = None,
        areas: Sequence[msg.GroundArea] = (),
        limbs: Limbs | None = None,
        limits: Limits | None = None,
    ) -> None:
        """`prior`: hash of the file of the prior map that `elevation` holds, `name` its name; empty where it holds
        none. start: x, y [m], yaw [rad] of the robot in `map` as configured. `later`: reads the prior map, which
        `elevation` does not hold yet, for a process that was started anew: it gets its map from the planner, the prior
        one in it, and needs no other. `areas`: those that were drawn on the prior map. `limbs`: None takes those of
        the default robot. `limits`: what the robot drives over; None: not known, and no cost is told.
        """
        clouds = {t.CLOUDS[lidar.name]: lidar.name for lidar in lidars}
        self.inputs = (
            *(t.ODOM, *clouds, t.JOINTS, t.TF_STATIC),
            *(t.MAP_REQUEST, t.MAP_PRIOR, t.MAP_CLOSED, t.MAP_MIRROR),
            *(t.ROUTE_STATUS, t.INITIAL_POSE, t.TOUCHED),
            t.AREAS_REQUEST,
        )
        self.map = elevation
        self._limbs = limbs or describe().limbs
        self._params = params
        self._limits = limits
        self._lidars = lidars
        self._topics = clouds
        self._sensors = {lidar.name: Sensor.of(lidar) for lidar in lidars}
        self._silent = dict.fromkeys(self._sensors, 0)
        """Scans in a row without points, by LiDAR."""
        self._waiting = Scans(self._sensors)
        self._frame = MapFrame()
        self._course = Course()
        self._finder = None if params.finder == OURS else OwnFinder(params.finder)
        self._prior = Prior(prior, name, start, later=later, finder=self._finder)
        self._location = Location()
        if prior and later is None:
            self._prior.take(elevation)
            self._location = self._prior.search()
            if not self._location.state.known:
                elevation.reset()  # nothing of it holds before the robot is found in it
        self._stands = False
        self._crept = False
        """The robot is on ground that nobody saw, or was sent there."""
        self._odom: msg.Odometry | None = None
        self._scans = 0
        self._fused = 0
        """Stamp of the newest scan in the map [ns]."""
        self._now = 0
        self._detail = ""
        self._status_due = 0
        self._refused = 0
        self._closing: Closing | None = None
        self._handover = Handover(elevation)
        """This process was restarted: nothing is mapped before the planner's copy of the map has come back."""
        self._areas = msg.Areas(areas=list(areas))
        self._areas_due = bool(areas)
        self._sending = MapBlocks()
        self._more = False
        """More has changed than is told at once."""

    def warm_up(self) -> None:
        """Compile the kernels, and those of the messages' way to them on a throw-away stage."""
        self.map.warm_up()
        if self._location.state is not State.NONE:
            warm_up()
        stage = ElevationStage(ElevationMap(self.map.params), self._params, self._lidars, limbs=self._limbs)
        for topic, message in rehearsal(tuple(self._topics)):
            stage.on(topic, decode(encode(message), topic.kind))

    def warm_up_rest(self) -> None:
        """The search in a prior map, which may be loaded later."""
        warm_up()

    def put_on(self, folder: Path) -> None:
        """See `KeepsMap`."""
        self.map.put_on(folder)

    def close(self) -> None:
        """Nothing to release."""

    def on(self, topic: Topic, message: Any) -> Outputs:
        """Take one message."""
        try:
            if t.ODOM.carried(message, topic):
                self._waiting.pose(message)
                self._odom = message
                self._stands = stands(message)
            elif topic in self._topics:
                self._waiting.cloud(stamp_of(message), self._topics[topic], cloud_points(message))
            elif t.JOINTS.carried(message, topic):
                self._waiting.joints(joint_sample(message))
            elif t.TF_STATIC.carried(message, topic):
                return self._move(jumped=self._frame.take(message))
            elif t.INITIAL_POSE.carried(message, topic):
                if self._odom is not None:
                    self._location.tell(message, self._odom)
                    self._status_due = 0
            elif t.MAP_PRIOR.carried(message, topic) or t.MAP_CLOSED.carried(message, topic):
                return self._take_prior(message)
            elif t.TOUCHED.carried(message, topic):
                x, y, z = xyz(message.pose.position).tolist()
                self.map.touch(x, y, z, yaw_of(message.pose.orientation), stamp_of(message))
            elif t.AREAS_REQUEST.carried(message, topic):
                return self._draw(message)
            elif t.AREAS.carried(message, topic):  # of the process before this one
                self._areas, self._areas_due = message, True
            elif t.MAP_REQUEST.carried(message, topic):
                return self._request(message)
            elif t.MAP_STATUS.carried(message, topic):
                self._take_over(message)
            elif t.MAP_MIRROR.carried(message, topic) and self._handover.under_way:
                if whole := self._handover.take(message, self._now):
                    self._detail, self._status_due = whole, 0
            elif t.ROUTE_STATUS.carried(message, topic):
                self._crept = message.crept
                if self._handover.spoken(stamp_of(message)):
                    return self._give_up()
            return self._join()
        except (LayoutError, MapError):
            self._refused += 1
            return []

    def _join(self) -> Outputs:
        # Where the robot started must be known before anything is mapped.
        if self._handover.under_way or not self._frame.known:
            return []
        return [output for scan in self._waiting.take() for output in self._fuse(scan)]

    def _fuse(self, scan: Scan) -> Outputs:
        stamp, odom, clouds, joints = scan
        position, orientation = self._frame.pose3(
            xyz(odom.pose.pose.position), xyzw(odom.pose.pose.orientation)
        )
        self._course.follow(position, stamp)
        sigmas = self._sigmas(odom)
        self._scans += 1
        self._fused = stamp
        seen = []
        for name, sensor in self._sensors.items():
            points = clouds.get(name, NO_POINTS)
            self._silent[name] = 0 if len(points) else self._silent[name] + 1
            if len(points):
                self.map.fuse(points, position, orientation, stamp, sensor, *sigmas)
                seen.append((sensor, points))
                if self._scans % self._params.clean_every == 0:
                    self.map.clean()
        if seen and self._scans % self._params.clean_every == 0:
            self.map.find_plants()
        # Where the head's LiDAR is to look at the ground at the feet, nothing is taken for granted that it does not
        # look at; nor where the wheels come to ground before a LiDAR has seen it.
        looks = "head" not in self._sensors or len(clouds.get("head", NO_POINTS)) > 0
        self.map.grant(self._silent.get("head", 0) < SILENT_SCANS and not self._crept)
        if joints is not None:
            start = None if looks and not self._crept else False
            self.map.fuse_ground(wheel_contacts(self._limbs, joints), position, orientation, stamp, start)
        if self._locate(odom, seen, joints):
            return self._begin("the robot was found")
        outputs: Outputs = []
        if self._scans % self._params.publish_every == 1 or self._more:
            patches = self.map.take_patches()
            self._more = sum(p.layers["elevation"].size for p in patches) >= AT_A_TIME
            outputs += [(t.MAP_UPDATE, patch_msg(p)) for p in patches]
        window = self.map.window(position[0], position[1], self._params.window)
        return [*outputs, (t.MAP_WINDOW, patch_msg(window))]

    def show(self) -> Outputs:
        """See `Shows`: what the ground around the robot costs; nothing before there is any."""
        if (place := self._course.place) is None or self._limits is None:
            return []
        ground = self.map.window(place[0], place[1], COST_REACH)
        return [(t.MAP_COST, cost_msg(ground.stamp, traversal_cost(ground.grid(), self._limits), ground))]

    def _locate(
        self,
        odom: msg.Odometry,
        seen: list[tuple[Sensor, NDArray[np.float32]]],
        joints: JointSample | None,
    ) -> bool:
        """Look for the robot in the prior map. Returns whether it was found just now where it was thought to be."""
        before = self._location.state
        if joints is not None:
            self._location.scan(odom, seen, stand_height(self._limbs, joints.position))
        now = self._location.state
        if now is not before:
            self._status_due = 0
        return self._location.settle(self._frame) or (now is not before and now is State.ASSUMED)

    def _sigmas(self, odom: msg.Odometry) -> tuple[float, float]:
        """Standard deviations of roll or pitch [rad] and of the height [m] of a pose: the odometry's own, or the
        configured where those are larger.
        """
        variance = np.diag(np.reshape(odom.pose.covariance, (6, 6)))
        p = self.map.params
        return (
            max(p.attitude_sigma, math.sqrt(max(0.0, *variance[3:5]))),
            max(p.height_sigma, math.sqrt(max(0.0, variance[2]))),
        )

    def _blind(self) -> str:
        """Warning for the operator about the LiDARs, in plain words."""
        silent = [name for name, scans in self._silent.items() if scans >= SILENT_SCANS]
        words = [f"nothing from the {' and the '.join(silent)} LiDAR"] if silent else []
        if "head" not in self._sensors:
            words.append("no LiDAR sees the ground at the feet: around the start it is taken for granted")
        elif "head" in silent:
            words.append("the ground at the feet is not seen: the robot drives on what it saw before alone")
        return "; ".join(words)

    def _felt(self) -> str:
        """What was touched, for the operator."""
        count = self.map.touched
        return (
            f"{count} places were touched that the LiDAR does not see; `map clear` forgets them"
            if count
            else ""
        )

    def _take_prior(self, message: msg.MapPrior) -> Outputs:
        try:
            fence_of(message.areas)
        except GeofenceError as error:
            raise LayoutError(str(error)) from error
        patches = tuple(map_patch(block, self.map.epoch) for block in message.map)
        if not patches:
            raise LayoutError("a prior map without a block")
        if patches[0].stamp == self._prior.stamp:
            return []  # a repeat
        if self._closing is not None and patches[0].stamp == self._closing.prior.stamp:
            return []
        target = target_of(message)
        if (target is None and not self._stands) or (target and not self._location.state.known):
            why = "moves" if target is None else "does not know where it is"
            self._detail, self._status_due = f"the map was not loaded: the robot {why}", 0
            return []
        cloud = cloud_points(message.cloud) if message.cloud.point_step else NO_POINTS
        cloud = checked_cloud(cloud, "the loaded map")
        start = self._frame.offset if target is None else target[0]
        prior = Prior(
            message.id, "the loaded map", start, patches, cloud, patches[0].stamp, finder=self._finder
        )
        if target is not None:
            self._closing = Closing(prior, target[1], until_of(message), self._frame.offset, self._fused)
            self._location.close(start)
            return self._tell() + self._move(jumped=False)  # it may be there already
        self._prior = prior
        self._location = self._prior.search()
        self._areas, self._areas_due = msg.Areas(areas=message.areas), True
        return self._begin("the map was loaded")

    def _move(self, *, jumped: bool) -> Outputs:
        """The frames were told: `odom` lies where it lay, or elsewhere in `map`."""
        settled, closing = self._location.settle(self._frame), self._closing
        if not jumped and not settled:
            return []
        self._closing = None
        if closing is None or not settled:  # somebody set the pose while the map was being closed
            self._location = self._location if closing is None else Location()
            return self._begin("the pose was set")
        known = closing.take(self.map, self._fused, jumped=jumped)
        self._prior, self._more = closing.prior, True
        self._course.forget()
        self._detail = f"the loops of the map were closed; {known} cells are known from before"
        return self._tell()

    def _tell(self) -> Outputs:
        """The status, now."""
        self._status_due = 0
        return self.tick(self._now)

    def _begin(self, why: str) -> Outputs:
        """Start anew from the prior map: what was mapped stands elsewhere now. Readers hear of the new epoch first."""
        known = 0
        try:
            self._prior.read()
        except MapError as error:  # it was there when the stack was started
            why = f"{why}; {error}"
        if not self._prior.patches:
            self._prior.id = ""
        if not self._prior.patches or not self._location.state.known:
            self.map.reset()
        else:
            known = self.map.begin_on(self._prior.patches, self._prior.cloud)
        self._sending.stop()
        self._course.forget()
        self._waiting.forget()
        self._detail, self._status_due = f"{why}; {known} cells are known from before", 0
        return self.tick(self.map.stamp)

    def _draw(self, wanted: msg.Areas) -> Outputs:
        """Other areas, or why not."""
        try:
            fence_of(wanted.areas)
            self._areas.areas, refused = wanted.areas, ""
        except GeofenceError as error:
            refused = str(error)
        self._areas = replace(self._areas, id=wanted.id, refused=refused)
        return self._tell_areas()

    def _tell_areas(self) -> Outputs:
        self._areas_due = False
        self._areas.header = header(self._now, MAP)
        return [(t.AREAS, self._areas)]

    def _request(self, message: msg.MapRequest) -> Outputs:
        if message.action in ("full", "parts"):
            try:
                if not self._scans:
                    return []
                blocks = self._blocks(message.action)
                cloud = cloud_msg(self.map.stamp, MAP, self.map.cloud.points)
                return [
                    *self._tell_areas(),
                    (t.MAP_CLOUD, cloud),
                    *self._sending.begin(message.action, blocks),
                ]
            except MapError as error:
                self._detail, self._status_due = str(error), 0
                raise
        if message.action == "clear":
            self._detail = f"forgot {self.map.forget_touched()} places that the robot touched"
        else:
            self._detail = f"unknown request {message.action!r}"
        self._status_due = 0
        return []

    def _blocks(self, action: str) -> Iterator[tuple[Topic, msg.Message]]:
        """The map block by block. Raises MapError while it is empty."""
        if action == "full":
            return ((t.MAP_FULL, patch_msg(self.map.complete(box))) for box in self.map.boxes(WHOLE_CELLS))
        return ((t.MAP_PARTS, part) for part in map_parts(self.map.boxes(), self.map.read, self.map.stamp))

    def _take_over(self, status: msg.MapStatus) -> None:
        """What the process before this one said last. Raises LayoutError where it cannot have."""
        restoring = possible(status) and (status.known_cells > 0 or status.restoring)
        another = status.prior != self._prior.id
        if self._prior.later and not (restoring and (status.location in LOCATED or another)):
            self._prior.read()
            self._location = self._prior.search()
            if self._location.state.known and not restoring:
                self.map.begin_on(self._prior.patches, self._prior.cloud)
        if not possible(status):
            raise LayoutError(f"no map began anew {status.epoch} times")
        self._handover.under_way = restoring
        if another:  # one was loaded meanwhile; what was made of it comes back
            self.map.reset()
            self._prior = Prior(status.prior)
            self._location = Location()
        self._location.restore(status)
        self.map.epoch = max(self.map.epoch, status.epoch)
        if math.isfinite(status.height_correction):
            self.map.alignment.height = status.height_correction

    def _give_up(self) -> Outputs:
        """Nobody has the map of before: begin anew, on the prior map where there is one."""
        words = self._handover.give_up()
        if self._prior.id and self._location.state.known:
            return self._begin(words)
        self._detail, self._status_due = words, 0
        return []

    def tick(self, now: int) -> Outputs:
        """Status twice a second, with the stamp of the newest scan in the map: who depends on the map sees how old it
        is."""
        self._now = now
        if self._areas_due:
            return [*self._tell_areas(), *self.tick(now)]
        if self._handover.overdue(now):
            return self._give_up()
        sent = self._sending.due()
        if now < self._status_due <= now + STATUS_PERIOD:  # a clock that was set back must not silence it
            return sent
        self._status_due = now + STATUS_PERIOD
        tiles, known, trusted = self.map.store.counts()
        status = msg.MapStatus(
            header=header(self._fused, "map"),
            epoch=self.map.epoch,
            scans=self._scans,
            tiles=tiles,
            known_cells=known,
            trusted_cells=trusted,
            resolution=self.map.params.resolution,
            height_correction=self.map.alignment.height,
            restoring=self._handover.under_way,
            prior=self._prior.id,
            warning="; ".join(
                filter(None, (self._course.warning, self._blind(), self._felt(), self.map.warning))
            ),
            touched=self.map.touched,
            refused=self._refused,
            detail=self._detail,
            **self._location.report(),
        )
        return [*sent, (t.MAP_STATUS, status)]


def build(config: StackConfig) -> ElevationStage:
    """From the stack's configuration. Raises MapError when the prior map cannot be read."""
    return _build(config, _prior(config) if config.map_file else _empty(config))


def build_again(config: StackConfig) -> ElevationStage:
    """The same for a process that was started anew and is handed the last status of the one before: to read a large
    prior map takes seconds."""
    return _build(config, _empty(config), partial(_prior, config) if config.map_file else None)


def _empty(config: StackConfig) -> ElevationMap:
    return ElevationMap(config.elevation, config.crossing())


def _prior(config: StackConfig) -> ElevationMap:
    elevation = _empty(config)
    elevation.load_prior(Path(config.map_file))
    return elevation


def _build(
    config: StackConfig, elevation: ElevationMap, later: Callable[[], ElevationMap] | None = None
) -> ElevationStage:
    graph = config.graph_params()
    return ElevationStage(
        elevation,
        config.elevation_stage,
        config.mounted_lidars(),
        fingerprint(config.map_file),
        config.start_pose(),
        Path(config.map_file).name,
        later,
        read_areas(Path(config.map_file)) if config.map_file else (),
        config.facts.limbs,
        Limits(graph.max_step, graph.max_slope),
    )
