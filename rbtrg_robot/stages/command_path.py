"""The way of commands and requests to the gate: who has the motion, and which stop a `resume` releases."""

from __future__ import annotations

import logging
from collections import Counter

from hal.safety.gate import Refusal, RefusalReason, SafetyGate, StopCause
from hal.safety.monitors import BLIND_HANDS, OLD_HANDS
from hal.safety.mux import TELEOP, TRACKER, CommandMux, Source
from hal.types import NS, ModeRequest, PostureCommand, VelocityCommand
from rbtrg_robot import msg
from rbtrg_robot.latch import number
from rbtrg_robot.wire.messages import stamp_of

log = logging.getLogger(__name__)

UNKNOWN = "unknown request"
HANDS_LAST = NS
"""[ns] the age of what hands saw is told after their last command."""
LARGEST_LATCH = 1 << 62
"""Latch numbers from here on are not taken over: what rises from there does not fit into a message, and the next stop
would end this process."""


class CommandPath:
    """Commands and requests of everybody, on their way to the gate.

    In: velocity commands with their source and sender, requests. Out: commands, stops and releases for the gate.
    It decides whose command counts and which `resume` is meant. It never makes a velocity of its own. Times in ns
    of the source clock.
    """

    def __init__(self, gate: SafetyGate) -> None:
        self._gate = gate
        self._mux = CommandMux(TRACKER, TELEOP)
        self._latch = 0
        """Names what `resume` must release; it rises with every stop and every time somebody takes the motion."""
        self._latched = False
        self._hands: tuple[int, float] | None = None
        """When the newest command by hand came [ns], and how old what its sender had seen was [s]."""
        self.turned_away: Counter[str] = Counter()
        """Commands and requests that did not reach the gate, by reason."""

    def drive(self, source: Source, message: msg.TwistStamped, sender: str, now: int) -> None:
        """A velocity command of `sender`. A command by hand counts from its arrival, because its clock is another
        one: its stamp is the newest stamp of the robot that the sender saw."""
        stamp = self._counts(source, message, sender, now)
        if stamp is not None:
            v, turn = message.twist.linear, message.twist.angular
            self._gate.command(VelocityCommand(stamp, v.x, v.y, turn.z, message.header.frame_id), now)

    def tilt(self, source: Source, message: msg.TrunkCommand, sender: str, now: int) -> None:
        """A tilt of the trunk by `sender`; stamped as velocities are."""
        stamp = self._counts(source, message, sender, now, "trunk")
        if stamp is not None:
            self._gate.posture(PostureCommand(stamp, roll=message.roll, pitch=message.pitch), now)

    def _counts(
        self,
        source: Source,
        message: msg.TwistStamped | msg.TrunkCommand,
        sender: str,
        now: int,
        channel: str = "",
    ) -> int | None:
        """When what `message` commands begins to count [ns]; None where it does not."""
        if not self._has_say(source, sender, now, channel):
            return None
        if source is not TELEOP:
            return stamp_of(message)
        if refusal := self._blind(stamp_of(message), now):
            self._gate.refuse(refusal, now)
            return None
        return now

    def _blind(self, seen: int, now: int) -> Refusal | None:
        """Why hands do not see what they do; `seen`: the newest stamp of the robot that they echo [ns]."""
        age = (now - seen) / NS
        if seen == 0 or age < -OLD_HANDS.high:
            stamp = "0" if seen == 0 else f"{-age:.1f} s ahead of the robot's clock"
            if BLIND_HANDS.active:
                return Refusal(RefusalReason.BLIND_HANDS, BLIND_HANDS.tell(stamp=stamp))
        # A stamp that is a little ahead was told at the same time, by another process.
        self._hands = now, max(age, 0.0)
        if OLD_HANDS.outside(max(age, 0.0)):
            said = OLD_HANDS.tell(age=f"{age:.1f}")
            return Refusal(RefusalReason.OLD_HANDS, said)
        return None

    def hands(self, now: int) -> float:
        """How old what the hands saw was when their newest command came [s]; -1 while nobody drives by hand."""
        if self._hands is None or not 0 <= now - self._hands[0] < HANDS_LAST:
            return -1.0
        return self._hands[1]

    def _has_say(self, source: Source, sender: str, now: int, channel: str = "") -> bool:
        taken, _ = self._mux.taken(now)
        why = self._mux.take(source, sender, now, channel)
        if self._mux.taken(now)[0] != taken:
            self._gate.forget()
            self._renew(now)
        if why.startswith("another"):
            self.turned_away[why] += 1
        return not why

    def request(self, message: msg.RobotCommand, now: int) -> ModeRequest | None:
        """Stop or release the gate. Returns what the backend must hear of, None where the request does not count."""
        if message.mode not in ModeRequest._value2member_map_:
            self.turned_away[UNKNOWN] += 1
            if self.turned_away[UNKNOWN] in (1, 10, 100, 1000):
                log.warning("request %r is not known", message.mode[:40])
            return None
        mode = ModeRequest(message.mode)
        if mode is ModeRequest.STOP:
            self._gate.stop(StopCause.OPERATOR, message.cause)
            self._latched = True
            self._renew(now, message.latch)
        elif mode is ModeRequest.RESUME:
            latch = self.latch(now)
            if message.latch != latch:  # a late repeat, or one that did not hear of the newest stop
                self.turned_away["resume of another stop"] += latch != 0
                return None
            self._gate.resume()
            self._latched = False
            if not self._mux.release(now):
                self._renew(now)
        return mode

    def restore(self, message: msg.RobotState) -> None:
        """Take back what was latched before a restart: a stop outlives a crash."""
        self._latch = message.latch if 0 <= message.latch < LARGEST_LATCH else 0
        if message.estop:
            self._gate.stop(StopCause.OPERATOR, message.estop_cause.removeprefix(f"{StopCause.OPERATOR}: "))
            self._latched = True
        if message.taken:
            self._mux.hold(TELEOP)

    def follow_gate(self, now: int) -> None:
        """Name a stop that the gate latched by itself."""
        latched = self._gate.latched
        if latched and not self._latched:
            self._renew(now)
        self._latched = latched

    def latch(self, now: int) -> int:
        """The number that a `resume` must name; 0 where there is nothing to release."""
        return self._latch if self._gate.latched or self._mux.taken(now)[0] else 0

    def taken(self, now: int) -> str:
        """Who took the motion from the stack, in words; empty where nobody did."""
        name, speaks = self._mux.taken(now)
        if not name:
            return ""
        if speaks:
            return f"{name} has the motion"
        return f"{name} had the motion; `rbtrg-robot resume` gives it back"

    def _renew(self, now: int, stop: int = 0) -> None:
        """Something new to release: a `resume` that is under way must not. `stop`: the name that its sender gave it."""
        self._latch = number(max(self._latch + 1, now), stop)
