"""What pages ask for: who may ask, and the orders that are under way. Orders are the commands' own
(`rbtrg_robot.orders`)."""

from __future__ import annotations

import asyncio
import logging
import math
import threading
import time
import uuid
from collections.abc import Callable, Coroutine
from typing import Any

from hal.errors import OperatorError
from hal.types import NS
from rbtrg_robot import msg
from rbtrg_robot import topics as t
from rbtrg_robot.config import StackConfig
from rbtrg_robot.console.feed import Feed, Slots
from rbtrg_robot.console.frames import route
from rbtrg_robot.console.lease import Lease
from rbtrg_robot.orders.goal import AskRoute, CancelGoal, SendGoal
from rbtrg_robot.orders.limits import USE_HARDWARE
from rbtrg_robot.orders.order import Order, Outcome, send
from rbtrg_robot.orders.photo import TakePhoto
from rbtrg_robot.orders.robot import POSTURES, Posture, Resume, Stop
from rbtrg_robot.orders.who import me
from rbtrg_robot.stages.navigation.goal import Goal, GoalArea, goal_request
from rbtrg_robot.stages.navigation.reasons import words
from rbtrg_robot.topics import Role
from rbtrg_robot.wire.bus import Bus, Received
from rbtrg_robot.wire.convert import BASE, vector
from rbtrg_robot.wire.messages import header, stamp_of

log = logging.getLogger(__name__)

POSTURE_LIMIT = 30.0
PRESENCE_PERIOD = 1.0
"""[s] between two signs that an operator watches."""
LOGS = ("replay", "pause replay", "live", "rerun")
"""Wishes that concern logs alone: from pages that show a replay, too."""
FREE = ("ask", "photo", *LOGS)
"""Wishes of pages that do not operate."""
RELEASE_TIME = 0.5
"""[s] after a confirmation: a state without a stop is a newer one."""
Answer = tuple[bool, str, dict[str, Any] | None]
"""Whether it was done, why not, and what was found out."""
Reply = Callable[[bool, str, dict[str, Any] | None], None]
"""Takes an `Answer`."""
TAKEN = "another page operates; take over first"
UNCONFIRMED = f"STOP NOT CONFIRMED: {USE_HARDWARE}"
FAILED = "the console failed at this: see its log"
ONLY_SEE = "this page may look and stop; an operator's address lets it do more"


class Refused(OperatorError):
    """What was asked for is not done; the message tells why."""


class Page:
    """One open page, or a program, as the desk knows it."""

    def __init__(self, number: int, role: Role, slots: Slots, kind: str = "page") -> None:
        self.number = number
        self.kind = kind
        self.slots = slots
        self.role = role
        self.driving = False


Wish = Callable[[Page, dict[str, Any]], Coroutine[Any, Any, Answer]]
"""What a page asks for. Raises OperatorError."""


def _seen(wish: dict[str, Any]) -> int:
    """The newest stamp of the robot that a page says it saw [ns]; 0 where it says none that can be one."""
    seen = str(wish.get("seen", ""))
    return int(seen) if seen.isascii() and seen.isdigit() and len(seen) < 20 and int(seen) < 1 << 62 else 0


def answer(outcome: Outcome) -> Answer:
    """To a wish that was one order."""
    return outcome.ok, outcome.words, None


class Desk:
    """Orders begin in the server's thread and go on in that of the bus."""

    SENDS = (
        *(t.ROBOT_STOP, t.ROBOT_COMMAND, t.GOAL_REQUEST, t.TELEOP, t.MAP_REQUEST, t.ROUTE_QUESTION),
        *(t.MISSION_REQUEST, t.PRESENCE, t.MAP_PRIOR, t.INITIAL_POSE, t.AREAS_REQUEST, t.PHOTO_REQUEST),
    )
    HEARS = (
        *(
            t.ROBOT_STATE,
            t.GOAL_STATUS,
            t.ROUTE_REPORT,
            t.MAP_CLOUD,
            t.MAP_PARTS,
            t.MAP_STATUS,
            t.MISSION_STATE,
        ),
        *(t.ODOM, t.TF_STATIC, t.AREAS, t.PHOTO),
    )

    def __init__(self, config: StackConfig, bus: Bus, feed: Feed, loop: asyncio.AbstractEventLoop) -> None:
        self._bus = bus
        self._feed = feed
        self._loop = loop
        self._lock = threading.Lock()
        self._orders: dict[Order, Callable[[Outcome], None]] = {}
        self.lease = Lease()
        self._stop: Stop | None = None
        self.stop_state: dict[str, Any] = {"state": "none", "words": "", "press": 0}
        """`press`: the newest stop of a page that it is about, counted from this process's start."""
        self._area = GoalArea.of(config)
        self._capabilities = config.capabilities()
        self.wishes: dict[str, Wish] = {
            "goal": self._goal,
            "home": self._home,
            "cancel": self._cancel,
            "resume": self._resume,
            "posture": self._posture,
            "ask": self._ask,
            "photo": self._photo,
        }
        """What pages may ask for; others add theirs."""
        self._present = self._confirmed = -math.inf
        self._tasks: set[asyncio.Task[None]] = set()
        for topic in self.SENDS:
            bus.advertise(topic)

    # --- the server's thread ----------------------------------------------------------------------------------

    def do(self, page: Page, wish: dict[str, Any], reply: Reply) -> None:
        """One wish of a page. Raises Refused."""
        what = str(wish.get("do"))
        if what == "stop":
            self.stop()
            return
        if what != "drive" and what not in self.wishes:
            raise Refused(f"unknown wish {what[:40]!r}")
        if page.role is not Role.OPERATOR:
            raise Refused(ONLY_SEE)
        if what not in LOGS and page.slots.feed is not self._feed:
            raise Refused("this page shows a replay: nothing moves from here")
        if what not in FREE and not self.lease.take(page.number, time.monotonic()):
            raise Refused(TAKEN)
        if what == "drive":
            self._drive(page, wish)
            return
        task = self._loop.create_task(self._grant(self.wishes[what], page, wish, reply))
        self._tasks.add(task)
        task.add_done_callback(self._tasks.discard)

    @staticmethod
    async def _grant(act: Wish, page: Page, wish: dict[str, Any], reply: Reply) -> None:
        try:
            reply(*await act(page, wish))
        except OperatorError as error:
            reply(False, str(error), None)
        except Exception:
            log.exception("a wish failed: %.200s", wish)
            reply(False, FAILED, None)

    async def carry_out(self, order: Order) -> Outcome:
        """Send an order and wait for how it ends."""
        ended: asyncio.Future[Outcome] = self._loop.create_future()
        self._begin(order, lambda outcome: None if ended.done() else ended.set_result(outcome))
        return await ended

    def only_standing(self, what: str) -> None:
        """Raises Refused while the robot moves or has somewhere to go."""
        if self._feed.busy:
            raise Refused(f"{what} while the robot stands and has no goal")

    def alive(self, page: Page, now: float, wish: dict[str, Any] | None = None) -> None:
        """The page says that it is there, when it joins and twice a second after that: it keeps the lease, or takes it
        where nobody has it. It is told how old what it sees is, there and back again on its link.

        `watched`: it is in front of somebody and shows what is. Whoever operates is then in contact with the mission.
        """
        wish = wish or {}
        watched, seen = bool(wish.get("watched")), _seen(wish)
        if seen and self._feed.state is not None and page.slots.feed is self._feed:
            page.slots.tell("link", {"delay": max(0.0, (stamp_of(self._feed.state) - seen) / NS)})
        if page.role is not Role.OPERATOR or not self.lease.take(page.number, now):
            return
        if watched and now - self._present >= PRESENCE_PERIOD:
            self._present = now
            stamp = time.time_ns()
            self._bus.publish(
                t.PRESENCE, msg.Presence(header=header(stamp, ""), owner=self.owner(page)), stamp
            )

    def take_over(self, page: Page, now: float) -> None:
        """Whoever operates now does so no longer. Raises Refused."""
        if page.role is not Role.OPERATOR:
            raise Refused(ONLY_SEE)
        self.lease.take(page.number, now, confirmed=True)

    def leave(self, page: Page) -> None:
        """It was closed: what it drove stands."""
        if page.driving:
            self._velocity(0.0, 0.0, 0 if self._feed.state is None else stamp_of(self._feed.state))
        self.lease.give_back(page.number)

    def stop(self) -> None:
        """The emergency stop: needs no lease. Sent at once, and repeated until the robot says it."""
        self.stop_state["press"] += 1
        if self._stop is not None and self._stop.outcome is None:  # it is being repeated already
            self._say_stop(self.stop_state["state"], self.stop_state["words"])
            return
        order = self._stop = Stop("console")
        self._say_stop("sending", "STOP sent, waiting for the robot")
        self._begin(order, self._stopped)

    def watch_stop(self, now: float) -> None:
        """Say that nobody confirms; forget a stop that was confirmed and then released, from wherever."""
        state = self._feed.state
        if (
            self.stop_state["state"] == "confirmed"
            and now > self._confirmed + RELEASE_TIME
            and state
            and not state.estop
        ):
            self._say_stop("none", "")
        if self._stop is not None and self._stop.worried(now) and self.stop_state["state"] == "sending":
            self._say_stop("unconfirmed", UNCONFIRMED)

    def _stopped(self, outcome: Outcome) -> None:
        if outcome.ok:
            self._confirmed = time.monotonic()
            self._say_stop("confirmed", "STOP confirmed by the robot")
        else:
            self._say_stop("unconfirmed", UNCONFIRMED)

    def _say_stop(self, state: str, text: str) -> None:
        self.stop_state |= {"state": state, "words": text}
        self._feed.tell("stop", self.stop_state)

    def place_of(self, wish: dict[str, Any]) -> tuple[float, float, float | None]:
        """x, y [m], heading [rad] in `map` of a wish. Raises Refused, in the navigator's words."""
        try:
            x, y = float(wish["x"]), float(wish["y"])
            yaw = None if wish.get("yaw") is None else float(wish["yaw"])
        except (KeyError, TypeError, ValueError, OverflowError) as error:
            raise Refused("a goal is x and y in metres") from error
        wrong = Goal("", x, y, yaw, 0).misplaced(self._area)
        if wrong is not None:
            raise Refused(words(wrong[0], wrong[1]))
        return x, y, yaw

    async def _goal(self, page: Page, wish: dict[str, Any]) -> Answer:
        x, y, yaw = self.place_of(wish)
        goal_id = uuid.uuid4().hex[:12]
        name = str(wish.get("name", ""))[:64]
        fields = {"name": name, "owner": self.owner(page), "accept_risk": wish.get("accept") is True}
        fields["no_return"] = wish.get("no_return") is True
        request = goal_request(time.time_ns(), goal_id, x, y, yaw, **fields)
        outcome = await self.carry_out(SendGoal(request, wait=False))
        return outcome.ok, outcome.words, {"id": goal_id}

    async def _home(self, page: Page, _wish: dict[str, Any]) -> Answer:
        home = self._feed.known().get("mission", {}).get("home")
        if home is None:
            raise Refused("where home is is not known: the robot does not know yet where it is")
        return await self._goal(page, {**home, "name": "home"})

    async def _cancel(self, page: Page, _wish: dict[str, Any]) -> Answer:
        return answer(await self.carry_out(CancelGoal(owner=self.owner(page))))

    async def _resume(self, page: Page, _wish: dict[str, Any]) -> Answer:
        return answer(await self.carry_out(Resume(self.owner(page))))

    async def _posture(self, _page: Page, wish: dict[str, Any]) -> Answer:
        what = str(wish.get("what"))
        if what not in POSTURES:
            raise Refused(f"there is no posture {what[:20]!r}")
        order = Posture(what, POSTURE_LIMIT)
        outcome = await self.carry_out(order)
        return outcome.ok, outcome.words or order.said, None

    async def _ask(self, _page: Page, wish: dict[str, Any]) -> Answer:
        """How would it go? The planner answers; nothing moves."""
        x, y, yaw = self.place_of(wish)
        if not self._feed.located:
            raise Refused("where the robot is is not known yet")
        x0, y0, yaw0 = self._feed.place
        order = AskRoute(
            msg.RouteQuestion(
                header=header(time.time_ns(), "map"),
                id=uuid.uuid4().hex[:12],
                start_x=x0,
                start_y=y0,
                start_yaw=yaw0,
                goal_x=x,
                goal_y=y,
                goal_yaw=yaw or 0.0,
                has_goal_yaw=yaw is not None,
                graph=bool(wish.get("graph")),
            )
        )

        outcome = await self.carry_out(order)
        return outcome.ok, outcome.words, None if order.report is None else route(order.report)

    async def _photo(self, page: Page, _wish: dict[str, Any]) -> Answer:
        return answer(await self.carry_out(TakePhoto(self.owner(page))))

    def _drive(self, page: Page, wish: dict[str, Any]) -> None:
        try:
            v, w = float(wish["v"]), float(wish["w"])
        except (KeyError, TypeError, ValueError, OverflowError) as error:
            raise Refused("a velocity is v, w and what the page saw") from error
        if not all(map(math.isfinite, (v, w))):
            raise Refused("a velocity is finite")
        if not (v or w or page.driving):
            return  # who does not drive takes no motion away
        robot = self._capabilities
        v = max(-robot.max_vx, min(robot.max_vx, v))
        w = max(-robot.max_wz, min(robot.max_wz, w))
        page.driving = bool(v or w)
        self._velocity(v, w, _seen(wish))

    def _velocity(self, v: float, w: float, seen: int) -> None:
        """`seen`: the newest stamp of the robot that the page had when its hands moved [ns]; the robot judges it."""
        stamp = time.time_ns()
        message = msg.TwistStamped(header=header(seen, BASE))
        message.twist.linear = vector((v, 0.0, 0.0))
        message.twist.angular = vector((0.0, 0.0, w))
        self._bus.publish(t.TELEOP, message, stamp)

    def owner(self, page: Page) -> str:
        """Who gives the orders of a page."""
        return f"{me()} ({page.kind} {page.number})"

    def _begin(self, order: Order, done: Callable[[Outcome], None]) -> None:
        """Send at once; the thread of the bus goes on with it."""
        with self._lock:
            send(self._bus, order)
            self._orders[order] = done  # only now: what cannot be sent is not tried again
        self._bus.wake()

    # --- the bus' thread --------------------------------------------------------------------------------------

    def take(self, received: Received[Any]) -> None:
        """An answer to orders."""
        with self._lock:
            waiting = [order for order in self._orders if received.topic in order.hears]
            if not waiting or (message := self._bus.open(received)) is None:
                return
            for order in waiting:
                order.take(received.topic, message)
        self.tick()

    def tick(self) -> None:
        """Repeat what was not answered; end what was."""
        with self._lock:
            for order, done in list(self._orders.items()):
                send(self._bus, order)
                if order.outcome is not None:
                    del self._orders[order]
                    self._loop.call_soon_threadsafe(done, order.outcome)
