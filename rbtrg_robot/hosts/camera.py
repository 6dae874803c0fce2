"""The camera process: frames while somebody looks, once a second while they are recorded, none otherwise.

In simulation it is a part of the simulator: it draws from the true pose, which no stage of the stack hears. It runs
beside the physics, so a slow picture delays no sample. Nothing is loaded before the first frame is due."""

from __future__ import annotations

import logging
import math
import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from hal.camera import CameraError, CameraFrame, CameraSource, MountedCamera
from rbtrg_robot import msg
from rbtrg_robot import topics as t
from rbtrg_robot.config import StackConfig
from rbtrg_robot.hosts.memory import give_back
from rbtrg_robot.log.moments import HEARS, TIME_AROUND, Moments
from rbtrg_robot.processes import BY_NAME
from rbtrg_robot.topics import Topic
from rbtrg_robot.wire.bus import Bus
from rbtrg_robot.wire.convert import CAMERA, xyz, xyzw
from rbtrg_robot.wire.heart import Heart
from rbtrg_robot.wire.messages import array, header, stamp_of

log = logging.getLogger(__name__)

LOOK_TIME = 2.0
"""[s] for which a request counts: whoever looks repeats it every second."""
RECORD_PERIOD = 1.0
"""[s] between two frames for the log."""
CORE_SHARE = 0.2
"""Of a core: frames that cost less come all the time."""
RETRY_AFTER = 5.0
"""[s] until a camera that failed is tried again."""
TURN_PERIOD = 0.02
"""[s]"""
REPEATS_TOLD = 2.0
"""[s] of one picture, bit by bit, until it is told: the noise of a sensor makes each one another."""
REPEATS = "it sends one picture again and again, so what it shows is old: it hangs, restart it"


@dataclass(slots=True)
class Demand:
    """When the next frame is due. Times in s of one clock."""

    rate: float
    """Most frames a second [Hz]."""
    recorded: bool
    always: bool | None = False
    """None: where it costs little."""
    cost: float = math.inf
    """Time of a core that a frame takes [s]."""
    _looks_until: float = -math.inf
    _last: float = -math.inf

    def looked_at(self, now: float, seconds: float = LOOK_TIME) -> None:
        """Somebody looks for so long, or something happened that will be looked at."""
        self._looks_until = max(self._looks_until, now + seconds)

    def due(self, now: float) -> bool:
        """Whether a frame is due; then the next one is due a period later."""
        cheap = self.cost * self.rate < CORE_SHARE
        if now < self._looks_until or (self.always is None and cheap) or self.always:
            period = 1.0 / self.rate
        elif self.recorded:
            period = max(RECORD_PERIOD, 1.0 / self.rate)
        else:
            return False
        if now - self._last < period:
            return False
        self._last = now if now - self._last > 2.0 * period else self._last + period
        return True


def source_of(config: StackConfig, camera: MountedCamera) -> CameraSource:
    """Where the frames of this stack come from. Raises CameraError."""
    if config.camera.source != "robot":
        from hal.camera.stream import StreamCamera

        return StreamCamera(camera, config.camera.source)
    if config.simulated:
        from hal.mujoco.view.camera import RenderedCamera
        from rbtrg_robot.hosts.robot import CLOCK_BEGIN

        return RenderedCamera(camera, config.load_scene(), config.sim.obstacles, CLOCK_BEGIN, config.facts)
    from hal.unitree.video import HeadCamera

    return HeadCamera(camera, config.interface, config.unitree_options().dds_domain(config.interface))


def main(
    config: StackConfig, bus: Bus, stopping: Callable[[], bool], _restored: dict[Topic, bytes] | None = None
) -> None:
    """The process, until told to stop."""
    heart = Heart(bus, BY_NAME["camera"].name)
    camera = config.camera.mounted()
    if camera is None:
        while not stopping():
            heart.beat(detail="no camera: camera.source is off")
            bus.take(0.1)
        return
    for topic in (t.CAMERA, t.CAMERA_INFO, t.PHOTO):
        bus.advertise(topic)
    rendered = config.simulated and config.camera.source == "robot"
    bus.subscribe((t.CAMERA_REQUEST, t.PHOTO_REQUEST, *HEARS, *((t.TRUTH, t.JOINTS) if rendered else ())))
    bus.publish(t.CAMERA_INFO, info_msg(camera, 0), 0)
    desk = Desk(config, camera)
    try:
        while not stopping():
            heart.beat(detail=desk.trouble)
            for received in bus.take(TURN_PERIOD):
                message = bus.open(received)
                if message is not None:
                    desk.take(received.topic, message, time.monotonic())
            frame = desk.frame(time.monotonic(), bus.clock())
            if frame is not None:
                image = image_msg(camera, frame)
                bus.publish(t.CAMERA, image, frame.stamp)
                if desk.keeps():
                    bus.publish(t.PHOTO, image, frame.stamp)
    finally:
        desk.close()


class Desk:
    """The source, opened when the first frame is due, and who wants frames."""

    def __init__(self, config: StackConfig, camera: MountedCamera) -> None:
        self._config, self._camera = config, camera
        self._demand = Demand(camera.rate, config.record, config.camera.always)
        self._moments = Moments()
        self._kept = False
        """Somebody wants the next frame kept."""
        self._source: Any = None
        self._retry = -math.inf
        self._drawn = config.simulated and config.camera.source == "robot"
        """Two pictures may be alike."""
        self._newest = b"", 0.0
        """The picture that came last, and when it came first [s]."""
        self.trouble = ""
        """What an operator should know, in plain words."""

    def take(self, topic: Topic, message: Any, now: float) -> None:
        """A message, at `now` [s]."""
        if topic is t.CAMERA_REQUEST:
            self._demand.looked_at(now)
        elif topic is t.PHOTO_REQUEST:
            self._kept = True
            self._demand.looked_at(now)
        elif topic in HEARS:
            if self._moments.begins(topic, message):
                self._demand.looked_at(now, TIME_AROUND)
        elif self._source is not None and t.TRUTH.carried(message, topic):
            place = message.pose.pose
            self._source.follow(stamp_of(message), xyz(place.position), xyzw(place.orientation))
        elif self._source is not None and t.JOINTS.carried(message, topic):
            self._source.joints(message.position)

    def frame(self, now: float, clock: int) -> CameraFrame | None:
        """The frame that is due at `now` [s], if there is one; `clock`: that of the sources [ns]."""
        if now < self._retry or not self._demand.due(now):
            return None
        try:
            if self._source is None:
                source = source_of(self._config, self._camera)
                log.info("camera: %s", source.open())
                self._source = source
                give_back()
            began = time.process_time()
            frame: CameraFrame | None = self._source.frame(clock)
        except CameraError as error:
            if self.trouble != str(error):
                log.warning("camera: %s", error)
            self.trouble, self._retry = str(error), now + RETRY_AFTER
            self.close()
            return None
        if frame is None:
            return None
        self._demand.cost = time.process_time() - began
        if frame.jpeg == self._newest[0] and not self._drawn:
            self.trouble = REPEATS if now - self._newest[1] > REPEATS_TOLD else ""
            return None  # a new stamp makes no new picture
        self._newest, self.trouble = (frame.jpeg, now), ""
        return frame

    def keeps(self) -> bool:
        """Whether the frame that just came is a photo."""
        kept, self._kept = self._kept, False
        return kept

    def close(self) -> None:
        """Release the source."""
        if self._source is not None:
            self._source.close()
            self._source = None


def image_msg(camera: MountedCamera, frame: CameraFrame) -> msg.CompressedImage:
    """sensor_msgs/CompressedImage in the optical frame."""
    return msg.CompressedImage(
        header=header(frame.stamp, CAMERA + camera.name),
        format="jpeg",
        data=np.frombuffer(frame.jpeg, np.uint8),
    )


def info_msg(camera: MountedCamera, stamp: int) -> msg.CameraInfo:
    """sensor_msgs/CameraInfo of a pinhole without distortion."""
    k = camera.matrix
    projection = [*k[0], 0.0, *k[1], 0.0, *k[2], 0.0]
    return msg.CameraInfo(
        header=header(stamp, CAMERA + camera.name),
        height=camera.height,
        width=camera.width,
        distortion_model="plumb_bob",
        d=array([0.0] * 5, "float64"),
        k=array(k.ravel().tolist(), "float64"),
        r=array([1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0], "float64"),
        p=array(projection, "float64"),
    )
