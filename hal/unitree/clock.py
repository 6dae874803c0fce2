"""Stamps of a clock that is not ours: find the offset, keep it, tell a delay from a step of that clock."""

from __future__ import annotations

from collections import deque

from hal.safety.monitors import CLOCK_DRIFT, CLOCK_STEP
from hal.types import NS

SUPPORT_COUNT, RECENT_COUNT = 3, 10
"""A message is never received before it was stamped, so the smallest difference of both counts. A single wrong stamp
must not count: the third smallest of the last ten readings is taken."""
ON_TIME = NS // 20
"""[ns] of delay beyond the shortest: what network and polling add when all is well. Later is late."""
LEAST_HOLE = NS // 10
"""[ns] of stamps that are missing where messages became late: a queue delays, but it loses no more than this."""


class RemoteClock:
    """Offset from a remote clock to ours, from stamps and receive times.

    The offset is the smallest receive-minus-stamp. Once known it grows no faster than two crystals drift apart
    (`CLOCK_DRIFT`), and not at all while messages are late: a late message was delayed, and its stamp tells its true
    age. An earlier one is followed.

    A delay cannot make stamps go back or come too close. If they do, that clock stepped. The step is followed once
    some messages in a row confirm it. A source that `answers` requests is asked first: `doubtful` says so, `restart`
    ends it. A step while nothing came looks like a delay. It stays one, unless a source that answers shows that the
    way is short."""

    def __init__(self, *, answers: bool = False) -> None:
        """`answers`: of the motion computer, whose requests have a round trip."""
        self._answers = answers
        self.offset: int | None = None
        """Add to a remote stamp to get host time [ns]; None before the first message."""
        self.steps = 0
        """How often the remote clock was set."""
        self.step = 0
        """Size of the newest step [ns], ahead is positive."""
        self.stepped_at: int | None = None
        """When it was found [ns, host clock]."""
        self._forget()

    def _forget(self) -> None:
        self._recent: deque[tuple[int, int]] = deque(maxlen=RECENT_COUNT)
        """Receive time and smallest difference of the last readings of the link."""
        self._newest: dict[str, int] = {}
        """Newest believed stamp of each stream."""
        self._difference: dict[str, int] = {}
        """Receive-minus-stamp of it."""
        self._received = 0
        self._on_time = True
        self._hole = False
        self._strange: list[int] = []
        """Differences of the last messages, in a row, whose stamps went back."""

    def hear(self, stamp: int, received: int, stream: str = "", gap: int = 1) -> bool:
        """Take a remote stamp and its receive time [ns]. Returns whether it can be believed: no stamp that went back,
        none from the future.

        `gap` [ns]: stamps of this stream do not follow closer than that."""
        difference = received - stamp
        last = self._newest.get(stream)
        if last is not None and CLOCK_STEP.active and self._went_back(difference, stamp < last + gap, stream):
            if (self._answers and self._known) or len(self._strange) < SUPPORT_COUNT:
                return False
            self.restart(received)
        ahead = self._follow(difference, received)
        if ahead > ON_TIME:
            return False
        on_time = -ahead <= ON_TIME
        if self._on_time and not on_time:
            self._hole = last is not None and stamp - last > LEAST_HOLE
        self._on_time, self._received = on_time, received
        self._newest[stream], self._difference[stream] = stamp, difference
        return True

    def _went_back(self, difference: int, back: bool, stream: str) -> bool:
        """Whether this message belongs to a clock that was set back, rather than to the one believed until now."""
        strange = self._strange
        if not back and strange:  # the stamps have passed those of before
            back = abs(difference - strange[-1]) < abs(difference - self._difference[stream])
        if not back:
            strange.clear()
            return False
        if strange and abs(difference - strange[-1]) > ON_TIME:
            strange.clear()
        strange.append(difference)
        del strange[:-SUPPORT_COUNT]
        return True

    def _follow(self, difference: int, received: int) -> int:
        """Bring the offset up to date; how far this message is ahead of it [ns], negative: after it."""
        recent = self._recent
        if recent and recent[-1][0] == received:
            difference_now = min(recent.pop()[1], difference)
        else:
            difference_now = difference
        recent.append((received, difference_now))
        if not CLOCK_DRIFT.active:
            self.offset = difference
            return 0
        smallest = sorted(value for _, value in recent)[min(SUPPORT_COUNT, len(recent)) - 1]
        if self.offset is None or len(recent) <= SUPPORT_COUNT:
            self.offset = smallest
            return self.offset - difference
        if difference > self.offset and self._on_time:
            grown = self.offset + round(CLOCK_DRIFT.high * 1e-6 * (received - self._received))
            self.offset = min(difference, grown)
        if smallest < self.offset:
            if self.offset - smallest > ON_TIME:
                self._note_step(self.offset - smallest, received)
            self.offset = smallest
        return self.offset - difference

    def _note_step(self, step: int, now: int) -> None:
        if self._known:  # the first messages may be anything
            self.steps += 1
            self.step, self.stepped_at = step, now

    @property
    def _known(self) -> bool:
        return len(self._recent) == RECENT_COUNT

    def restart(self, now: int) -> None:
        """The source's clock was set, not its messages delayed: learn it anew."""
        newest = self._strange[-1] if self._strange else max(self._difference.values(), default=0)
        if self.offset is not None:
            self._note_step(self.offset - newest, now)
        self._forget()
        self.offset = None

    @property
    def back(self) -> float:
        """By how much the stamps went back [s], where a source that answers has to be asked; 0 where they did not."""
        if self.offset is None or len(self._strange) < SUPPORT_COUNT:
            return 0.0
        return (self._strange[-1] - self.offset) / NS

    @property
    def doubtful(self) -> bool:
        """Whether it may be a step of the source's clock that makes its messages late."""
        return len(self._strange) >= SUPPORT_COUNT or (self._hole and not self._on_time)

    def date(self, stamp: int, received: int) -> int:
        """A believed stamp on the host clock [ns], never after `received`."""
        return received if self.offset is None else min(stamp + self.offset, received)

    def late(self, stream: str = "") -> float:
        """By how much longer than the shortest the newest message of a stream took [s]."""
        if self.offset is None or stream not in self._difference:
            return 0.0
        return max(self._difference[stream] - self.offset, 0) / NS

    def newest(self, stream: str = "") -> int | None:
        """Its newest believed stamp on the host clock [ns]; None before the first."""
        stamp = self._newest.get(stream)
        return (
            None
            if stamp is None or self.offset is None
            else stamp + min(self.offset, self._difference[stream])
        )
