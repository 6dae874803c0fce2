"""Whether a robot's folder holds together, and what it lacks: for who brings one (`rbtrg-robot robot check`)."""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import TYPE_CHECKING, Literal, NamedTuple

import numpy as np

from hal.errors import OperatorError
from hal.limbs import LEGS, wheel_centres
from hal.robots.outline import urdf
from hal.robots.robot import Robot
from hal.rotation import up_of

if TYPE_CHECKING:
    from hal.mujoco.sim import Simulation

MASS_SHARE, PLACE_TOLERANCE = 0.05, 0.02
"""Share of the mass, and [m] of a wheel's place, by which model and description may differ."""

FALLEN_TILT = math.radians(60.0)
"""Tilt of the trunk [rad] that counts as a fall."""


class Finding(NamedTuple):
    """One thing that was looked at."""

    verdict: Literal["ok", "missing", "wrong"]
    words: str
    """What it is; of what is missing also what that costs."""


def findings(robot: Robot) -> Iterator[Finding]:
    """All there is to say of a robot."""
    body, limbs = robot.body, robot.limbs
    centres = wheel_centres(limbs, robot.pose)
    reach = 2.0 * (np.abs(centres[:, 0]).max() + (limbs.radius if robot.wheeled else 0.0))
    across = 2.0 * np.abs(centres[:, 1]).max() + limbs.tread_width
    if reach > body.length + 2 * PLACE_TOLERANCE or across > body.width + 2 * PLACE_TOLERANCE:
        yield Finding(
            "wrong",
            f"body: {body.length} x {body.width} m is smaller than its wheels reach, {reach:.2f} x {across:.2f} m",
        )
    else:
        yield Finding(
            "ok", f"stands {robot.height:.3f} m high on {reach:.2f} x {across:.2f} m, {body.mass} kg"
        )
    names = {lidar.name for lidar in robot.lidars}
    if "main" not in names:
        yield Finding("missing", "lidars: no main one; the stack does not start without it")
    if "head" not in names:
        yield Finding(
            "missing",
            "lidars: none in the head; ground at the feet counts as assumed until the main one saw it",
        )
    if not robot.description:
        yield Finding(
            "missing", "description: RViz and Foxglove show boxes and lines instead of a URDF of its own"
        )
    try:
        urdf(robot)
    except OperatorError as error:
        yield Finding("wrong", f"description: {error}")
    yield from _envelopes(robot)
    if "sim" in robot.backends:
        yield from _simulation(robot)
    if robot.backends == ("sim",):
        yield Finding("missing", "backends: only sim; no real robot is driven")


def _envelopes(robot: Robot) -> Iterator[Finding]:
    from hal.envelope import PARTS, EnvelopeError, limits, read

    for name in robot.controllers:
        measure = f"python -m tools.bench envelope --robot-model {robot.folder} --controller {name} --write"
        try:
            envelope = read(robot.envelope_file(name))
        except EnvelopeError as error:
            yield Finding("wrong", f"{name}: {error}; the planner needs it: {measure}")
            continue
        lacks = [manoeuvre for manoeuvre in PARTS if manoeuvre not in envelope.manoeuvres]
        if lacks:
            yield Finding(
                "missing", f"{name}: {', '.join(lacks)} cost nothing until they are measured: {measure}"
            )
            continue
        able = robot.capabilities(name)
        over = [
            f"{key} {getattr(able, key):.2f} (measured {value:.2f})"
            for key, value in limits(envelope).items()
            if key != "step_vx" and getattr(able, key) > value + 1e-9
        ]
        drives = sum(table.drives for table in envelope.manoeuvres.values())
        if over:
            yield Finding(
                "missing", f"{name}: declares more than {drives} drives bear out: {', '.join(over)}"
            )
        else:
            yield Finding("ok", f"{name}: declares no more than {drives} drives bear out")


def _simulation(robot: Robot) -> Iterator[Finding]:
    """Build it, put it on flat ground, drive it for two seconds."""
    from hal.mujoco.sim import Simulation

    try:
        model = robot.model()
    except OperatorError as error:
        yield Finding("wrong", f"simulated: {error}")
        return
    sim = Simulation(np.zeros((200, 200), np.float32), 0.05, (-5.0, -5.0), robot=model)
    mass = float(sim.model.body_mass.sum())
    if abs(mass - robot.body.mass) > MASS_SHARE * robot.body.mass:
        yield Finding("wrong", f"simulated: weighs {mass:.2f} kg, robot.yaml says {robot.body.mass} kg")
    sim.reset()
    world = np.array([sim.data.geom_xpos[sim.model.geom(f"{leg}_wheel").id] for leg in LEGS])
    off = float(
        np.abs((world - sim.position) @ sim.rotation - wheel_centres(robot.limbs, sim.low_state().q)).max()
    )
    if off > PLACE_TOLERANCE:
        yield Finding("wrong", f"simulated: its wheels lie up to {off:.3f} m from where `limbs` says")
    for name in robot.own:
        yield _driven(robot, sim, name, "")


def driven(robot: Robot, name: str, policy: str) -> Finding:
    """How a controller with that learnt policy drives on flat ground in simulation. Raises an OperatorError."""
    from hal.mujoco.sim import Simulation

    ground = np.zeros((200, 200), np.float32)
    return _driven(robot, Simulation(ground, 0.05, (-5.0, -5.0), robot=robot.model()), name, policy)


def _driven(robot: Robot, sim: Simulation, name: str, policy: str) -> Finding:
    from hal.mujoco.driver import Driver

    try:
        controller = robot.model().controller(name, policy, 0.005)
    except OperatorError as error:
        return Finding("missing", f"{name}: {error}")
    sim.reset()
    driver = Driver(sim, controller)
    driver.settle(1.0)
    speed = min(0.4, robot.capabilities(name).max_vx)
    begin, tilt = sim.position, 0.0
    for tick in range(round(5.0 / sim.timestep)):
        if tick == round(3.0 / sim.timestep):
            begin = sim.position
        driver.step(speed)
        tilt = max(tilt, math.acos(min(up_of(sim.quaternion)[2], 1.0)))
        if tilt > FALLEN_TILT:
            words = f"{name}: told {speed} m/s it falls over after {tick * sim.timestep:.1f} s on flat ground"
            return Finding("wrong", words)
    drove = float(np.linalg.norm((sim.position - begin)[:2])) / 2.0
    leant = math.degrees(tilt)
    words = f"{name}: told {speed} m/s it drives {drove:.2f} m/s on flat ground and tilts by {leant:.0f} deg"
    return Finding("ok" if 0.7 * speed < drove < 1.3 * speed else "wrong", words)
