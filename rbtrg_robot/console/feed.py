"""What pages see: the newest of every kind, and how old each topic is. A slow page misses what was overtaken, and
delays nobody."""

from __future__ import annotations

import asyncio
import contextlib
import json
import logging
import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

from hal.types import NS, Capabilities
from mapping.elevation.exchange import MapError
from rbtrg_robot import msg
from rbtrg_robot import topics as t
from rbtrg_robot.console import frames
from rbtrg_robot.console.terrain import Key, Terrain
from rbtrg_robot.orders.words import goal_line, robot_line
from rbtrg_robot.process.events import KEPT_EVENTS as KEPT_EVENTS
from rbtrg_robot.process.events import plain
from rbtrg_robot.stages.navigation.goal import ACTIVE
from rbtrg_robot.topics import Topic
from rbtrg_robot.wire.bus import Bus, Received
from rbtrg_robot.wire.convert import LayoutError, cloud_points, map_patch, xyz, xyzw
from rbtrg_robot.wire.frames import MapFrame, stands
from rbtrg_robot.wire.messages import header, stamp_of

log = logging.getLogger(__name__)

TERRAIN_PERIOD = 0.5
"""[s] between two terrain frames of a page."""
AGES_PERIOD = 1.0
"""[s] between two frames of ages."""
LOOKS_PERIOD = 0.5
"""[s] between two clouds that tell which cells are seen."""
ASK_AGAIN = 3.0
"""[s] until the whole map is asked for again."""
VIDEO_AGAIN = 1.0
"""[s] between two requests for pictures while a page shows them."""
HEARD: tuple[Topic, ...] = (
    t.ODOM,
    t.CAMERA,
    t.CAMERA_INFO,
    t.TF_STATIC,
    *t.CLOUDS.values(),
    t.MAP_UPDATE,
    t.MAP_FULL,
    t.ROUTE_REPORT,
    t.EVENTS,
    *frames.PLAIN,
)

KEPT = (
    *(t.CAMERA_INFO, t.TF_STATIC, t.ROBOT_STATE, t.GOAL_STATUS, t.MAP_STATUS, t.ODOM, t.ROUTE_REPORT),
    *(t.MISSION_ORDER, t.MISSION_STATE, t.EVENTS, t.AREAS),
)
"""Decoded while nobody looks, too: they come once, or orders need them."""


class Slots:
    """What one page has still to get, the newest of each kind. Belongs to the server's thread."""

    def __init__(self, feed: Feed) -> None:
        self.feed = feed
        """What it sees."""
        self.seeing = False
        """The page takes what comes."""
        self.cloud = False
        """It draws points."""
        self.video = False
        """It shows the camera."""
        self.waiting: dict[str, bytes] = {}
        self.wake = asyncio.Event()
        self.ages = False
        """It shows how old the ground is."""
        self.tiles: dict[Key, int] = {}
        self.aged: dict[Key, int] = {}
        self.terrain_due = self.ages_due = 0.0

    def put(self, kind: str, frame: bytes) -> None:
        """A newer frame of a kind."""
        if (kind == "points" and not self.cloud) or (kind == "picture" and not self.video):
            return
        self.waiting.pop(kind, None)
        self.waiting[kind] = frame
        self.wake.set()

    def tell(self, kind: str, content: dict[str, Any]) -> None:
        """A frame for this page alone."""
        self.put(kind, frames.pack(kind, content))

    def clear(self) -> None:
        """What waits is of another picture."""
        self.waiting.clear()
        self.tiles.clear()
        self.aged.clear()
        self.terrain_due = self.ages_due = 0.0

    def take(self) -> tuple[str, bytes] | None:
        """The one that waits longest."""
        for kind in self.waiting:
            return kind, self.waiting.pop(kind)
        self.wake.clear()
        return None


class Feed:
    """`take` runs in the bus' thread; pages join and leave in the server's. Decodes nothing while nobody looks."""

    def __init__(
        self,
        bus: Bus,
        robot: Capabilities,
        loop: asyncio.AbstractEventLoop,
        *,
        replayed: bool = False,
        folder: Path | None = None,
    ) -> None:
        """`replayed`: of a log, where nobody sends the whole map. folder: see `Terrain`."""
        self._replayed = replayed
        self._bus = bus
        self._loop = loop
        self._pages: frozenset[Slots] = frozenset()  # replaced, never changed: two threads read it
        self._away: frozenset[Slots] = frozenset()
        self._frame = MapFrame()
        self._arrived: dict[Topic, float] = {}
        self._told: dict[Topic, float] = {}
        self._looked: dict[Topic, float] = {}
        self._frames: dict[str, bytes] = {}
        self._ears: frozenset[tuple[Topic, Callable[[Any], None]]] = (
            frozenset()
        )  # as the pages: never changed
        self._epoch, self._correction = 0, 0.0
        self._asked = -ASK_AGAIN
        self._filmed = -VIDEO_AGAIN
        self._lens: dict[str, Any] = {}
        self._source = (0, 0.0)
        """Newest stamp of the robot's state [ns], which is sent when it is made, and when it came [s]."""
        """The newest of the camera, while somebody looks."""
        self._odom: msg.Odometry | None = None
        self._phase: Any = None
        self.place = (0.0, 0.0, 0.0)
        """x, y [m], heading [rad] of the robot in `map`, once `located`."""
        self.located = False
        self._moving = self._goal_active = False
        self.state: msg.RobotState | None = None
        self.events: list[dict[str, Any]] = []
        """The newest that happened, oldest first. Belongs to the server's thread."""
        self.terrain = Terrain(robot, folder)
        self.terrain_lock = threading.Lock()

    # --- the server's thread ----------------------------------------------------------------------------------

    def join(self, page: Slots) -> None:
        """A page wants to see; it gets the newest of all kinds at once."""
        if not self._pages:
            with self.terrain_lock:
                self.terrain.forget()
            self._asked = -ASK_AGAIN
        page.seeing = True
        self._pages |= {page}
        for kind, frame in self._frames.items():
            page.put(kind, frame)
        self._bus.wake()

    def leave(self, page: Slots) -> None:
        """It was closed."""
        self._pages -= {page}

    def follow(self, page: Slots, *, away: bool) -> None:
        """A page that is `away` looks at something else; it gets what is told to all of them."""
        self._away = self._away | {page} if away else self._away - {page}

    @contextlib.contextmanager
    def listening(self, topic: Topic, hear: Callable[[Any], None]) -> Iterator[None]:
        """`hear` gets each message of a topic of HEARD, in the server's thread, whether pages look or not."""
        ear = topic, hear
        self._ears |= {ear}
        try:
            yield
        finally:
            self._ears -= {ear}

    def known(self) -> dict[str, Any]:
        """The newest content of each kind of JSON frame."""
        return {
            kind: {key: value for key, value in json.loads(frame[4:]).items() if key != "kind"}
            for kind, frame in self._frames.items()
        }

    def film(self) -> None:
        """Ask for pictures."""
        self._bus.publish(t.CAMERA_REQUEST, msg.String(data="console"), time.time_ns())

    def age(self, message: msg.Message) -> float:
        """[s] from the stamp of a sensor's message to now, on the clock of the sensors.

        A message newer than the newest of the clock is of now: the two come over different topics.
        """
        stamp, at = self._source
        return max(0.0, (stamp - stamp_of(message)) / NS + time.monotonic() - at)

    @property
    def looking(self) -> frozenset[Slots]:
        """The pages."""
        return self._pages

    @property
    def busy(self) -> bool:
        """The robot moves, or has a goal, as far as is known."""
        return self._moving or self._goal_active

    @property
    def pages(self) -> int:
        """How many look."""
        return len(self._pages)

    def tell(self, kind: str, content: dict[str, Any], *, keep: bool = True) -> None:
        """A frame for all pages, and for those that come later."""
        frame = frames.pack(kind, content)
        self._hand_out(kind, frame, keep)
        for page in self._away:
            page.put(kind, frame)

    def _hand_out(self, kind: str, frame: bytes, keep: bool) -> None:
        if keep:
            self._frames[kind] = frame
        for page in self._pages:
            page.put(kind, frame)

    def ages(self) -> dict[str, float]:
        """Seconds since the newest message of each steady topic."""
        now = time.monotonic()
        return {topic.name: round(now - at, 2) for topic, at in list(self._arrived.items()) if topic.rate}

    def terrain_for(self, page: Slots) -> None:
        """Put what changed of the map, at its pace."""
        now = time.monotonic()
        if not page.seeing or now < page.terrain_due or "terrain" in page.waiting:
            return
        page.terrain_due = now + TERRAIN_PERIOD
        with self.terrain_lock:
            tiles = self.terrain.newer(page.tiles, *self.place[:2])
        if tiles:
            page.put("terrain", frames.terrain(tiles))
        if page.ages and now >= page.ages_due and "ages" not in page.waiting:
            page.ages_due = now + AGES_PERIOD
            with self.terrain_lock:
                ages = self.terrain.ages(page.aged, page.tiles, *self.place[:2])
            if ages:
                page.put("ages", frames.ages(ages))

    # --- the bus' thread --------------------------------------------------------------------------------------

    def take(self, received: Received[Any]) -> None:
        """One message of HEARD."""
        now = time.monotonic()
        topic = received.topic
        self._arrived[topic] = now
        ears = [hear for heard, hear in self._ears if heard is topic]
        if not (topic in KEPT or self._pages or ears) or (message := self._bus.open(received)) is None:
            return
        if topic in KEPT or self._pages:
            self._show(topic, message, now)
        for hear in ears:
            self._loop.call_soon_threadsafe(hear, message)

    def status(self, answer: bytes) -> None:
        """What the supervisor says, with its lines in words."""
        status = json.loads(answer)
        if "robot" in status:
            status["lines"] = [robot_line(status["robot"]), goal_line(status["robot"])]
        self._loop.call_soon_threadsafe(self._hand_out, "status", frames.pack("status", status), True)

    def remember(self, events: list[dict[str, Any]]) -> None:
        """What happened, as `process.events.plain` tells it; what is known already does not count twice. From any
        thread."""
        self._loop.call_soon_threadsafe(self._remember, events)

    def _remember(self, events: list[dict[str, Any]]) -> None:
        known = {event["number"]: event for event in (*self.events, *events)}
        self.events = sorted(known.values(), key=lambda event: event["number"])[-KEPT_EVENTS:]
        self._hand_out("events", frames.pack("events", {"events": self.events}), True)

    def tick(self, now: float) -> None:
        """Ask for the map while pages look and none came; make what came ready."""
        with self.terrain_lock:
            self.terrain.prepare()
        if (
            any(page.video for page in self._pages)
            and not self._replayed
            and now - self._filmed > VIDEO_AGAIN
        ):
            self._filmed = now
            self.film()
        if self._pages and self.terrain.empty and not self._replayed and now - self._asked > ASK_AGAIN:
            self._asked = now
            stamp = time.time_ns()
            self._bus.publish(t.MAP_REQUEST, msg.MapRequest(header=header(stamp, ""), action="full"), stamp)

    def _show(self, topic: Topic, message: Any, now: float) -> None:
        if t.TF_STATIC.carried(message, topic):
            self._frame.take(message)
        elif t.ODOM.carried(message, topic):
            self._odom = message
            self._moving = not stands(message)
            if self._frame.known:
                content = frames.pose(message, self._frame, self._correction)
                self.place = (content["x"], content["y"], content["yaw"])
                self.located = True
                self._put(topic, "pose", content, now)
        elif t.EVENTS.carried(message, topic):
            self.remember([plain(message)])
        elif t.CAMERA.carried(message, topic):
            self._picture(message)
        elif t.CAMERA_INFO.carried(message, topic):
            self._lens = frames.lens(message)
        elif topic in (t.MAP_UPDATE, t.MAP_FULL):
            self._map(topic, message)
        elif topic in t.CLOUDS.values():
            self._cloud(topic, message, now)
        elif t.ROUTE_REPORT.carried(message, topic):
            if not message.question:
                self._put(topic, "route", frames.route(message), now)
        else:
            kind, make = frames.PLAIN[topic]
            if t.ROBOT_STATE.carried(message, topic):
                self.state = message
                self._source = stamp_of(message), now
            elif t.GOAL_STATUS.carried(message, topic):
                self._goal_active = message.state in ACTIVE
            elif t.MAP_STATUS.carried(message, topic):
                self._epoch, self._correction = int(message.epoch), message.height_correction
            self._put(topic, kind, make(message), now)

    def _put(self, topic: Topic, kind: str, content: dict[str, Any], now: float) -> None:
        changed = kind == "robot" and (content["phase"], content["estop"], content["taken"]) != self._phase
        if changed:
            self._phase = (content["phase"], content["estop"], content["taken"])
        if not changed and now - self._told.get(topic, 0.0) < frames.LEAST.get(topic, 0.0):
            return
        self._told[topic] = now
        self._loop.call_soon_threadsafe(self._hand_out, kind, frames.pack(kind, content), True)

    def _picture(self, message: msg.CompressedImage) -> None:
        """How old it is goes with it."""
        facts = {**self._lens, "age": self.age(message), "stamp": stamp_of(message) / NS}
        frame = frames.picture(message, facts)
        self._loop.call_soon_threadsafe(self._hand_out, "picture", frame, False)

    def _map(self, topic: Topic, message: msg.GridMap) -> None:
        with self.terrain_lock:
            if topic is t.MAP_UPDATE and self.terrain.empty and not self._replayed:
                return  # the whole map is under way
            try:
                self.terrain.take(map_patch(message, self._epoch))
            except (LayoutError, MapError) as error:
                log.warning("%s: %s", topic.name, error)

    def _cloud(self, topic: Topic, message: msg.PointCloud2, now: float) -> None:
        odom = self._odom
        if odom is None or not self._frame.known or stamp_of(odom) != stamp_of(message):
            return
        drawn = topic is t.CLOUD and any(page.cloud for page in self._pages)
        drawn = drawn and now - self._told.get(topic, 0.0) >= frames.LEAST[t.CLOUD]
        looked = now - self._looked.get(topic, 0.0) >= LOOKS_PERIOD
        if not drawn and not looked:
            return
        try:
            points = cloud_points(message)
        except LayoutError as error:
            log.warning("%s: %s", topic.name, error)
            return
        place, turn = self._frame.pose3(xyz(odom.pose.pose.position), xyzw(odom.pose.pose.orientation))
        place[2] += self._correction
        if looked:
            self._looked[topic] = now
            with self.terrain_lock:
                self.terrain.look(points, place, turn)
        if drawn:
            self._told[topic] = now
            frame = frames.points(points, place, turn)
            self._loop.call_soon_threadsafe(self._hand_out, "points", frame, False)
