"""A maze that is different for every seed: for tests that explore."""

from __future__ import annotations

import numpy as np

from hal.scenes.canvas import Canvas
from hal.scenes.scene import Goal, Scene

CORRIDOR_PITCH = 1.7
"""Corridor and wall together [m]."""


def maze(seed: int = 0, size: int = 6, loops: float = 0.15) -> Scene:
    """`size` x `size` rooms joined by a random tree, of whose walls a share `loops` is opened again.

    Start in the south-west corner; goal `exit` is the room furthest away by the corridors, `half` lies half-way there.
    """
    random = np.random.default_rng(seed)
    doors: set[tuple[tuple[int, int], tuple[int, int]]] = set()
    visited, stack = {(0, 0)}, [(0, 0)]
    while stack:
        room = stack[-1]
        fresh = [n for n in _beside(room, size) if n not in visited]
        if not fresh:
            stack.pop()
            continue
        step = fresh[int(random.integers(len(fresh)))]
        doors.add(_door(room, step))
        visited.add(step)
        stack.append(step)
    walls = [
        _door((i, j), n)
        for i in range(size)
        for j in range(size)
        for n in _beside((i, j), size)
        if n > (i, j)
    ]
    doors |= {w for w in walls if random.random() < loops}
    side = size * CORRIDOR_PITCH
    canvas = Canvas((0.0, side, 0.0, side), 0.04)
    for (i, j), (k, m) in walls:
        if ((i, j), (k, m)) in doors:
            continue
        x, y = max(i, k) * CORRIDOR_PITCH, max(j, m) * CORRIDOR_PITCH
        if i != k:
            canvas.bar((x, y), (x, y + CORRIDOR_PITCH), 0.12, 1.0)
        else:
            canvas.bar((x, y), (x + CORRIDOR_PITCH, y), 0.12, 1.0)
    canvas.border(0.08, 1.0)
    steps = _steps(doors, size)
    end = max(steps, key=lambda room: (steps[room], room))
    half = min(steps, key=lambda room: (abs(steps[room] - steps[end] / 2), room))
    goals: dict[str, Goal] = {
        name: ((i + 0.5) * CORRIDOR_PITCH, (j + 0.5) * CORRIDOR_PITCH, None)
        for name, (i, j) in {"exit": end, "half": half, "home": (0, 0)}.items()
    }
    return Scene(
        name="maze",
        height=canvas.array(),
        resolution=canvas.resolution,
        origin=canvas.origin,
        start=(
            0.5 * CORRIDOR_PITCH,
            0.5 * CORRIDOR_PITCH,
            0.0 if _door((0, 0), (1, 0)) in doors else 0.5 * np.pi,
        ),
        goals=goals,
        description=f"maze of {size} x {size} rooms, seed {seed}",
        allowed_area=((0.0, 0.0), (side, 0.0), (side, side), (0.0, side)),
    )


def _beside(room: tuple[int, int], size: int) -> list[tuple[int, int]]:
    i, j = room
    return [
        (a, b) for a, b in ((i + 1, j), (i, j + 1), (i - 1, j), (i, j - 1)) if 0 <= a < size and 0 <= b < size
    ]


def _door(a: tuple[int, int], b: tuple[int, int]) -> tuple[tuple[int, int], tuple[int, int]]:
    return (a, b) if a < b else (b, a)


def _steps(doors: set[tuple[tuple[int, int], tuple[int, int]]], size: int) -> dict[tuple[int, int], int]:
    """Rooms to cross from the start to each room."""
    steps, queue = {(0, 0): 0}, [(0, 0)]
    for room in queue:
        for other in _beside(room, size):
            if _door(room, other) in doors and other not in steps:
                steps[other] = steps[room] + 1
                queue.append(other)
    return steps
