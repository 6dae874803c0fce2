"""Faults of the way from hands to wheels: a robot that does not follow, another robot, hands that see too late, a LiDAR
that is silent."""

from __future__ import annotations

import math
import random

from hal.contract import BackendError
from hal.robots import describe
from hal.safety.monitors import BLIND_HANDS, GUARD_BLIND, MAIN_SILENT, OLD_HANDS, ROLLS_ON, TWO_ROBOTS
from hal.types import NS, LidarScan, Sample
from rbtrg_robot import msg
from rbtrg_robot import topics as t
from rbtrg_robot.config import load
from rbtrg_robot.hosts.lockstep import Lockstep
from rbtrg_robot.wire.convert import BASE
from rbtrg_robot.wire.messages import header
from tests.hal.unitree.robot import Faults, KinematicBody, RobotSide
from tests.hal.unitree.world import World
from tools.bench.faults.fault import Fault, Outcome
from tools.bench.faults.watch import Watch, by_hand, tap

PEER_REST = 0.05
"""[m/s]"""


def _driving(faults: Faults, speed: float, seed: int) -> World:
    """The simulated Unitree robot after two seconds at `speed` [m/s]."""
    world = World(faults)
    world.backend.connect()
    world.run(1.0 + random.Random(seed).random())
    world.run(2.0, vx=speed)
    return world


def _watched(world: World, seconds: float, speed: float = 0.0) -> Outcome:
    """What the robots of a world do from now on; the host asks for `speed` [m/s]."""
    began, x, moved_at, words = world.elapsed, world.body.x, world.elapsed, set()
    for _ in range(round(seconds / 0.02)):
        world.run(0.02, vx=speed)
        words.add(world.cause)
        if max(abs(robot.body.v) for robot in (world.robot, world.other) if robot) > PEER_REST:
            moved_at = world.elapsed
    rest = (moved_at - began) / NS
    return Outcome(
        abs(world.body.x - x), rest if rest < seconds - 0.1 else math.inf, "\n".join(sorted(words))
    )


def _rolls_on(speed: float, seed: int) -> Outcome:
    """It answers StopMove and rolls on; 20 s."""
    return _watched(_driving(Faults(rolls=True), speed, seed), 20.0)


def _other(serial: float, seed: int) -> RobotSide:
    """Another Go2-W on the DDS domain."""
    return RobotSide(KinematicBody(), Faults(serial=int(serial), epoch=100.0 * seed))


def _another_robot(serial: float, seed: int) -> Outcome:
    """It comes while this one drives."""
    world = _driving(Faults(serial=11), 0.5, seed)
    world.other = _other(serial, seed)
    world.run(0.02, vx=0.5)
    return _watched(world, 2.0, 0.5)


def _two_at_the_start(serial: float, seed: int) -> Outcome:
    world = World(Faults(serial=11))
    world.other = _other(serial, seed)
    try:
        world.backend.connect()
    except BackendError as error:
        return Outcome(words=str(error))
    world.run(2.0, vx=0.5)
    return Outcome(world.body.x, math.inf)


def _stack(seed: int) -> Lockstep:
    stack = Lockstep(
        load(None, ["record=false", "sim.lidar_step=8"], scene="yard", seed=seed, lidars=describe().lidars)
    )
    stack.wait_ready()
    return stack


def _old_hands(delay: float, seed: int) -> Outcome:
    """Hands on a link that takes `delay` [s], half each way: 1 s held, then let go."""
    stack = _stack(seed)
    with Watch(stack) as watch:
        sent: list[tuple[float, int]] = []
        for k in range(round((1.0 + delay + 1.0) * 25)):
            now = stack.seconds
            if k < 25:
                sent.append((now, stack.now))
            while sent and now - sent[0][0] >= delay:
                command = msg.TwistStamped(header=header(sent.pop(0)[1], BASE))
                command.twist.linear.x = 0.3
                stack.host.inject(t.TELEOP, command)
            stack.run(0.04)
        return watch.outcome()


def _blind_hands(ahead: float, seed: int) -> Outcome:
    """Hands whose commands are stamped `ahead` [s] of the robot's clock; with 0 they hold no stamp."""
    stack = _stack(seed)
    with Watch(stack) as watch:
        for _ in range(50):
            stamp = stack.now + round(ahead * NS) if ahead else 0
            command = msg.TwistStamped(header=header(stamp, BASE))
            command.twist.linear.x = 0.3
            stack.host.inject(t.TELEOP, command)
            stack.run(0.04)
        return watch.outcome()


def _silent(names: tuple[str, ...], speed: float, seed: int) -> Outcome:
    """LiDARs fall silent while hands drive."""
    stack = _stack(seed)
    by_hand(stack, speed, 0.0, 1.5)
    with Watch(stack) as watch:
        tap(stack, lambda samples: [s for s in samples if not _of(s, names)])
        by_hand(stack, speed, 0.0, 2.0)
        return watch.outcome()


def _of(sample: Sample, names: tuple[str, ...]) -> bool:
    return isinstance(sample, LidarScan) and sample.name in names


FAULTS = (
    # 1.5 s of patience: the robot's own hold of the last Move and its braking; or 0.3 m, whichever is later.
    Fault("rolls_on", (ROLLS_ON,), (0.15, 0.6), _rolls_on, rest=2.8, says=("StopMove is not followed",)),
    Fault(
        "another_robot",
        (TWO_ROBOTS,),
        (22.0, 33.0),
        _another_robot,
        rest=0.5,
        says=("serial numbers 11-0 and",),
    ),
    Fault(
        "two_robots_at_start",
        (TWO_ROBOTS,),
        (22.0, 0.0),
        _two_at_the_start,
        rest=0.5,
        says=("more than one robot",),
    ),
    Fault("old_hands", (OLD_HANDS,), (0.7, 3.0), _old_hands, rest=0.0, says=("their sender saw the robot",)),
    Fault(
        "blind hands", (BLIND_HANDS,), (0.0, 5.0), _blind_hands, rest=0.0, says=("none that the robot told",)
    ),
    Fault(
        "all LiDARs silent",
        (GUARD_BLIND,),
        (0.3, 0.5),
        lambda speed, seed: _silent(("main", "head"), speed, seed),
        rest=1.1,  # half a second of silence, braking
        says=("nobody sees what steps into the way",),
    ),
    Fault(
        "main_lidar_silent",
        (MAIN_SILENT,),
        (0.3, 0.5),
        lambda speed, seed: _silent(("main",), speed, seed),
        says=("the main LiDAR is silent for",),
    ),
)
