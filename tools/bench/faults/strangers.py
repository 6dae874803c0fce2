"""Another program on this computer publishes what belongs to a process of the stack: the robot process on a bus, driven
by hand."""

from __future__ import annotations

import math
import time

from hal.safety.gate import SafetyGate
from hal.safety.monitors import STRANGER
from hal.types import NS
from rbtrg_robot import msg
from rbtrg_robot import topics as t
from rbtrg_robot.stages.robot import STEP_PERIOD, RobotStage
from rbtrg_robot.wire.bus import Bus
from rbtrg_robot.wire.convert import BASE
from rbtrg_robot.wire.messages import header
from rbtrg_robot.wire.session import stack_id
from tests.hal.unitree.robot import Faults
from tests.hal.unitree.world import World
from tools.bench.faults.fault import Fault, Outcome
from tools.bench.faults.watch import REST_SPEED
from tools.bench.ports import free_endpoint

STRANGER_SECONDS = 3.0
"""[s] of the robot's time that the stranger publishes."""
LIMITS_EVERY = 8
"""Steps between two limits: 25 Hz."""
LONGEST_WAIT = 10.0
"""[s] for a message on loopback."""


def _limits(size: float, seed: int) -> Outcome:
    """The guard allows 0.3 m/s for a second, then nothing; a stranger allows `size` [m/s] all the while."""
    world = World(Faults())
    stage = RobotStage(
        world.backend, SafetyGate(world.backend.capabilities), simulated=False, watched=frozenset()
    )
    stage.warm_up()
    stack, endpoint = stack_id(), free_endpoint()
    with (
        Bus(endpoint, "supervisor", router=True, stack=stack),
        Bus(endpoint, "robot", stack=stack) as robot,
        Bus(endpoint, "guard", stack=stack) as guard,
        Bus(endpoint, "stranger") as stranger,
    ):
        robot.subscribe([t.MOTION_LIMITS])
        speed, since, start, moving, told = 0.4 + 0.05 * seed, 0, 0.0, 0, ""
        steps = round((1.0 + STRANGER_SECONDS) * NS / STEP_PERIOD)
        for step in range(steps):
            world.advance(STEP_PERIOD / NS)
            if step == round(NS / STEP_PERIOD):
                since, start = world.elapsed, world.body.x
            if step % LIMITS_EVERY == 0:
                command = msg.TwistStamped(header=header(world.now, BASE))
                command.twist.linear.x = speed
                stage.on(t.TELEOP, command, "hands")
                if not since:
                    _carry(guard, robot, stage, world.now, 0.3)
                _carry(stranger, robot, stage, world.now, size)
            stage.tick(world.now)
            moving = world.elapsed if abs(world.body.v) > REST_SPEED else moving
        end = time.monotonic() + LONGEST_WAIT
        while robot.refused and not (told := robot.intrusion()) and time.monotonic() < end:
            time.sleep(0.05)  # who it is comes in Zenoh's thread
    rest = math.inf if world.elapsed - moving < NS // 2 else max(moving - since, 0) / NS
    return Outcome(abs(world.body.x - start), rest, told)


def _carry(sender: Bus, robot: Bus, stage: RobotStage, now: int, forward: float) -> None:
    """One message of limits [m/s], sent until it has come or was refused; what comes is given to the robot process."""
    limits = msg.MotionLimits(
        header=header(now, BASE), forward=forward, backward=forward, left=1.0, right=1.0
    )
    refused = robot.refused
    end = time.monotonic() + LONGEST_WAIT
    while time.monotonic() < end:
        sender.publish(t.MOTION_LIMITS, limits, now)
        for received in robot.take(0.01):
            stage.on(received.topic, received.decode(), received.sender)
            return
        if robot.refused > refused:
            return
    raise RuntimeError("the bus carries nothing")


FAULTS = (Fault("stranger's limits", (STRANGER,), (9.0, 0.3), _limits, rest=0.5, says=("/guard/limits also "
    "comes from stranger",)),)  # fmt: skip
