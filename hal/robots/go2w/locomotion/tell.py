"""What a learnt policy needs, and what it would do to a robot that stands (`rbtrg-robot policy check`)."""

from __future__ import annotations

import time
from collections.abc import Iterator

import numpy as np

from hal.lowlevel import Ground, LowState
from hal.robots.go2w import facts as go2w
from hal.robots.go2w.locomotion.controllers import policy_of
from hal.robots.go2w.locomotion.description import TERMS
from hal.robots.go2w.locomotion.policy import PolicyController
from hal.types import GRAVITY, Array, PostureCommand, VelocityCommand

RUN_COUNT = 200
"""Of the network, for its time."""
ASKED_SPEED = 0.4
"""[m/s] that a standing robot is asked for."""
FAR_TARGET = 0.5
"""[rad] from where a joint stands: a first target beyond it throws the robot."""


def tell(source: str) -> Iterator[str]:
    """Line by line. Raises PolicyError."""
    path = policy_of("policy", source)
    controller = PolicyController(path)
    d, network = controller.description, controller.network
    yield f"{path}: {controller.form}"
    memory = f", remembers {network.remembers}" if network.remembers else ""
    yield (
        f"network: {network.what}: {network.inputs} numbers in, {network.outputs} out{memory}; "
        f"{_time(controller) * 1e3:.2f} ms a run on this machine, every {d.period * 1e3:.0f} ms"
    )
    for term in d.observation:
        ages = d.ages(term)
        history = "" if ages == (0,) else f", of {len(ages)} steps (ages {', '.join(map(str, ages))})"
        yield f"sees {term.term}: {d.size(term)} numbers{history}: {TERMS[term.term]}"
    braked = [name for name in go2w.MOTORS if name not in d.joints]
    yield f"moves {len(d.joints)} joints" + (f"; {', '.join(braked)} are braked" if braked else "")
    if count := len(controller.layout.places):
        yield (
            f"sees the map at {count} places, in simulation; the real robot's motors do not have it. Where the map is "
            f"too old or nobody saw the ground, it counts as {controller.layout.unknown} m below base_link"
        )
        controller.see(Ground(np.full(count, go2w.stand_height(go2w.STAND)), ""))
    yield from _first(controller)


def _time(controller: PolicyController) -> float:
    seen = np.zeros(controller.network.inputs, np.float32)
    times = []
    for _ in range(RUN_COUNT):
        began = time.perf_counter()
        controller.network(seen)
        times.append(time.perf_counter() - began)
    controller.network.reset()
    return float(np.median(times))


def _first(controller: PolicyController) -> Iterator[str]:
    """Its first output, as the robot stands in the policy's own pose and in ours."""
    for name, q in (("its own stance", controller.layout.default), ("the stance it is given", go2w.STAND)):
        controller.reset()
        zeros = np.zeros(16)
        upright, gravity = np.array([1.0, 0.0, 0.0, 0.0]), np.array([0.0, 0.0, GRAVITY])
        state = LowState(0.0, q.copy(), zeros, zeros, upright, np.zeros(3), gravity)
        command = controller.step(state, VelocityCommand(0, ASKED_SPEED), PostureCommand(0))
        legs = np.abs(command.q - q)[:12]
        torque = np.abs(command.tau + command.kp * (command.q - q) + command.kd * command.dq)
        most = int(np.argmax(torque / go2w.TORQUE_LIMIT))
        yield (
            f"told {ASKED_SPEED} m/s in {name} it first moves {_motor(legs)} by {legs.max():.2f} rad, "
            f"and asks {go2w.MOTORS[most]} for {torque[most]:.1f} of {go2w.TORQUE_LIMIT[most]:.1f} Nm"
            + (f": more than {FAR_TARGET} rad at once throws the robot" if legs.max() > FAR_TARGET else "")
        )
    controller.reset()


def _motor(values: Array) -> str:
    return go2w.MOTORS[int(np.argmax(values))]
