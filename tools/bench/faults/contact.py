"""What no LiDAR foretold: panes of glass, thin posts, a bar above the beams; by hand and on the way to a goal. And a
pane on a kerb that the LiDAR sees."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from typing import Any

from hal.safety.monitors import TOUCHED
from rbtrg_robot import topics as t
from rbtrg_robot.config import load
from rbtrg_robot.hosts.lockstep import Lockstep
from rbtrg_robot.stages.navigation.goal import GoalState
from tools.bench.faults.fault import Fault, Outcome
from tools.bench.faults.watch import Watch, by_hand

MET_DISTANCE = 1.1
"""[m] from base_link at the start to the middle of what is met."""
WORDS = ("touched something that the LiDAR does not see at (",)
CONTROLLERS: tuple[str, str] = ("vmc", "hybrid")
GIVEN_UP = 60.0
"""[s] for a goal 3 m away."""
TRUNK_HEIGHT = 0.42
"""[m] above the ground."""
KERB_HEIGHT = 0.10
"""[m] As high as both controllers climb."""
Boxes = tuple[dict[str, Any], ...]


def pane(degrees: float) -> Boxes:
    """A glass front 2 m wide, open on both sides, turned from across the way."""
    yaw = math.radians(degrees)
    return ({"centre": (MET_DISTANCE, 0.0, 0.6), "size": (0.02, 2.0, 1.2), "yaw": yaw, "clear": True},)


def pane_on_kerb(behind: float) -> Boxes:
    """A glass front [m] behind the face of a kerb."""
    kerb = {"centre": (MET_DISTANCE - behind + 1.0, 0.0, KERB_HEIGHT / 2), "size": (2.0, 3.0, KERB_HEIGHT)}
    return (*pane(0.0), kerb)


def post(left: float) -> Boxes:
    """Thin, as tall as the robot; [m] left of the way."""
    return ({"centre": (MET_DISTANCE, left, 0.5), "size": (0.05, 0.05, 1.0), "clear": True},)


def bar(height: float, degrees: float = 0.0) -> Boxes:
    """Across the way, turned by `degrees` from there; middle above the ground [m]."""
    yaw = math.radians(degrees)
    return ({"centre": (MET_DISTANCE, 0.0, height), "size": (0.04, 2.0, 0.06), "yaw": yaw, "clear": True},)


def low_bar(degrees: float) -> Boxes:
    """At the height of the trunk, turned from across the way."""
    return bar(TRUNK_HEIGHT, degrees)


def stack_before(boxes: Boxes, controller: str, seed: int) -> Lockstep:
    """On flat ground, ready, the boxes ahead; a few centimetres aside by seed."""
    sim = {"obstacles": boxes, "lidar_step": 8}
    flags: dict[str, Any] = {
        "scene": "flat",
        "origin": (0.0, 0.01 * (seed % 5 - 2), 0.0),
        "sim": sim,
        "controller": controller,
        "seed": seed,
    }
    stack = Lockstep(load(None, ["record=false"], **flags))
    stack.wait_ready()
    return stack


def met(stack: Lockstep) -> bool:
    """Whether something that no LiDAR sees is against a part of the robot just now, by the truth."""
    kerbs = [box.size[2] for box in stack.config.sim.obstacles if not box.clear]
    contacts = stack.robot.backend.simulation.contacts()  # type: ignore[attr-defined]
    return bool(((contacts.places[:, 2] > max(kerbs, default=0.0) + 0.03) & (contacts.forces > 1.0)).any())


def push(boxes: Boxes, controller: str, speed: float, seed: int) -> Outcome:
    """Driven by hand until 2 s after it met what is not seen, without letting go."""
    stack = stack_before(boxes, controller, seed)
    while not met(stack) and stack.seconds < 12.0:
        by_hand(stack, speed, 0.0, 0.04)
    with Watch(stack) as watch:
        by_hand(stack, speed, 0.0, 2.0)
        return watch.outcome()


def go_round(boxes: Boxes, controller: str, seed: int) -> Outcome:
    """To a goal behind the boxes; the last word is the end of the goal."""
    stack = stack_before(boxes, controller, seed)
    with Watch(stack) as watch:
        stack.send_goal(3.0, 0.0)
        stack.run(0.2)
        begun = stack.seconds
        while not GoalState(stack.newest[t.GOAL_STATUS].state).terminal and stack.seconds < begun + GIVEN_UP:
            stack.run(0.1)
        outcome = watch.outcome()
        return replace(outcome, words=f"{outcome.words}\n{stack.newest[t.GOAL_STATUS].state}")


def _by_hand(what: Callable[[float], Boxes]) -> Callable[[float, int], Outcome]:
    return lambda size, seed: push(what(size), CONTROLLERS[seed % 2], (0.5, 0.3, 0.4)[seed % 3], seed)


def _by_goal(what: Callable[[float], Boxes]) -> Callable[[float, int], Outcome]:
    return lambda size, seed: go_round(what(size), CONTROLLERS[seed % 2], seed)


FAULTS = (
    Fault("contact.pane", (TOUCHED,), (0.0, 60.0, 15.0, 30.0, 45.0), _by_hand(pane), rest=1.0, says=WORDS),
    Fault("contact.pane_on_kerb", (TOUCHED,), (0.25, 0.0), _by_hand(pane_on_kerb), rest=1.0, says=WORDS),
    Fault("contact.post", (TOUCHED,), (0.0, 0.2, 0.1), _by_hand(post), rest=1.0, says=WORDS),
    Fault("contact.bar", (TOUCHED,), (TRUNK_HEIGHT, 0.13), _by_hand(bar), rest=1.0, says=WORDS),
    Fault(
        "contact.pane_round", (TOUCHED,), (0.0, 45.0), _by_goal(pane), error=0.35, says=(*WORDS, "reached")
    ),
    Fault(
        "contact.bar_round",
        (TOUCHED,),
        (0.0, 60.0, 30.0),
        _by_goal(low_bar),
        error=0.35,
        says=(*WORDS, "reached"),
    ),
    Fault("contact.post_round", (TOUCHED,), (0.0, 0.2), _by_goal(post), error=0.35, says=(*WORDS, "reached")),
)
