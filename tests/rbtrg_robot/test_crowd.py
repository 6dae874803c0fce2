"""Who stays before and behind a door that many come to."""

from __future__ import annotations

import contextlib
import socket
from collections.abc import Iterator

import pytest

from rbtrg_robot.crowd import RUSH_COUNT, CrowdedSocket


class Visitor:
    """A connection, seen from both ends."""

    def __init__(self, door: CrowdedSocket, held: contextlib.ExitStack) -> None:
        self.outside = held.enter_context(socket.create_connection(door.getsockname()[:2], timeout=10.0))
        self.inside, self.address = door.accept()
        held.enter_context(self.inside)

    @property
    def sent_away(self) -> bool:
        self.inside.setblocking(False)
        try:
            return self.inside.recv(1) == b""
        except BlockingIOError:
            return False


@pytest.fixture
def held() -> Iterator[contextlib.ExitStack]:
    with contextlib.ExitStack() as stack:
        yield stack


def test_the_oldest_stranger_gives_way_to_the_newest_and_guests_stay(held: contextlib.ExitStack) -> None:
    door = held.enter_context(CrowdedSocket("127.0.0.1", 0, strangers=3, guests=2))
    guest = Visitor(door, held)
    assert door.admit(guest.address)
    strangers = [Visitor(door, held) for _ in range(7)]
    assert [stranger.sent_away for stranger in strangers] == [True] * 4 + [False] * 3
    assert strangers[0].outside.recv(1) == b"", "it is told at once"
    assert not guest.sent_away
    assert door.admit(guest.address), "it shows who it is with each request"


def test_strangers_that_have_left_keep_their_places_from_nobody(held: contextlib.ExitStack) -> None:
    door = held.enter_context(CrowdedSocket("127.0.0.1", 0, strangers=3, guests=2))
    stays = Visitor(door, held)
    for _ in range(7):
        Visitor(door, held).inside.close()
    assert not stays.sent_away


def test_no_more_guests_are_admitted_than_there_is_room_for_until_one_leaves(
    held: contextlib.ExitStack,
) -> None:
    door = held.enter_context(CrowdedSocket("127.0.0.1", 0, strangers=9, guests=2))
    first, second, third = (Visitor(door, held) for _ in range(3))
    assert door.admit(first.address)
    assert door.admit(second.address)
    assert not door.admit(third.address)
    assert door.connected == 3
    first.inside.close()
    assert door.connected == 2
    assert door.admit(third.address)
    assert not third.sent_away


def test_who_is_not_connected_is_not_admitted(held: contextlib.ExitStack) -> None:
    door = held.enter_context(CrowdedSocket("127.0.0.1", 0, strangers=9, guests=2))
    assert not door.admit(("127.0.0.1", 1))


def test_a_door_that_closes_sends_away_who_waits_before_it(held: contextlib.ExitStack) -> None:
    door = CrowdedSocket("127.0.0.1", 0, strangers=9, guests=2)
    guest, stranger = Visitor(door, held), Visitor(door, held)
    door.admit(guest.address)
    door.close()
    assert stranger.sent_away
    assert not guest.sent_away


def test_many_may_wait_however_few_a_server_accepts_in_a_turn(held: contextlib.ExitStack) -> None:
    door = held.enter_context(CrowdedSocket("127.0.0.1", 0, strangers=400, guests=2))
    door.listen(1)
    for _ in range(150):
        held.enter_context(socket.create_connection(door.getsockname()[:2], timeout=10.0))


def test_in_a_flood_who_asks_for_nothing_is_not_let_in(held: contextlib.ExitStack) -> None:
    door = CrowdedSocket("127.0.0.1", 0, strangers=999, guests=2, asks=lambda first: first == b"stop")
    held.enter_context(door).setblocking(False)

    def come(says: bytes, number: int) -> list[tuple[str, int]]:
        """They wait before the door. Addresses of those who are let in."""
        for _ in range(number):
            visitor = held.enter_context(socket.create_connection(door.getsockname()[:2], timeout=10.0))
            visitor.sendall(says)
        found = []
        with contextlib.suppress(BlockingIOError):
            while True:
                inside, address = door.accept()
                held.enter_context(inside)
                found.append(address)
        return found

    assert len(come(b"", 20)) == 20, "no flood"
    assert len(come(b"sto", RUSH_COUNT + 60)) == RUSH_COUNT
    assert len(come(b"", 20)) == 20, "it is over"
    assert len(come(b"stop", RUSH_COUNT + 60)) == RUSH_COUNT + 60
