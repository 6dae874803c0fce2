"""What the model-based controller does, written as outputs of the policy: the data that the first policy is cloned
from.

The robot is driven by the outputs, held for a policy step and disturbed; so the clone sees the states that its own
delays and errors lead
to. Only the teacher drives: labels of states that a bad pupil reaches contradict each other, for the teacher climbs
with a memory.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from hal.lowlevel import LowCommand, LowState
from hal.mujoco.attitude import AttitudeFilter
from hal.mujoco.sim import Simulation
from hal.robots.go2w import facts as go2w
from hal.robots.go2w.locomotion.layout import Layout
from hal.robots.go2w.locomotion.rlsar import FRAME_LENGTH
from hal.robots.go2w.locomotion.vmc import VmcController
from hal.rotation import up_of
from hal.types import Array, PostureCommand, VelocityCommand
from tools.bench.envelope.terrain import CELL_SIDE, course
from tools.bench.envelope.trial import TIPPED_COSINE, steering
from tools.train.settings import DESCRIPTION, PARAMS

LEVEL = "ramp_up_0"
"""Level ground, with any command."""
COURSES = (
    *(LEVEL,) * 6,
    *(
        "ramp_up_10",
        "ramp_up_20",
        "ramp_up_25",
        "ramp_down_15",
        "ramp_down_25",
        "cross_slope_15",
        "cross_slope_22",
    ),
    *("step_up_5", "step_up_8", "step_up_10", "step_up_12", "step_up_15", "step_down_10", "step_down_20"),
    *("rough_3", "rough_5", "bar0_5", "bar30_5", "stairs_up_8", "stairs_up_10"),
)
EPISODE_TIME = 10.0
"""[s]"""


def as_output(layout: Layout, state: LowState, command: LowCommand) -> NDArray[np.float32]:
    """The policy's output (16,) whose motor torque is that of the teacher's `command` now."""
    torque = command.tau + command.kp * (command.q - state.q) + command.kd * (command.dq - state.dq)
    torque = np.clip(torque, -go2w.TORQUE_LIMIT, go2w.TORQUE_LIMIT)
    out = np.empty(16)
    legs, kp, kd = slice(0, 12), layout.kp, layout.kd
    out[legs] = state.q[legs] + (torque[legs] + kd[legs] * state.dq[legs]) / kp[legs] - layout.default[legs]
    out[12:] = state.dq[12:] + torque[12:] / kd[12:]
    return np.clip(out / layout.scale, layout.lower, layout.upper).astype(np.float32)


def episode(seed: int) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """Frames (n, 57) and outputs (n, 16), one a policy step, of one drive on the exact model."""
    rng = np.random.default_rng(seed)
    name = COURSES[seed % len(COURSES)]
    ground, free = course(name, seed), name == LEVEL
    sim = Simulation(
        ground.height,
        CELL_SIDE,
        ground.origin,
        friction=float(rng.uniform(0.55, 1.05)),
        payload=float(rng.choice([0.0, 0.0, 1.5])),
    )
    sim.reset(
        rng.uniform(-0.2, 0.0),
        rng.uniform(-0.15, 0.15),
        rng.uniform(-np.pi, np.pi) if free else rng.uniform(-0.2, 0.2),
    )
    teacher, layout, attitude = VmcController(), Layout(DESCRIPTION), AttitudeFilter()
    held = LowCommand(layout.default.copy(), np.zeros(16), np.zeros(16), layout.kp.copy(), layout.kd.copy())
    frames: list[NDArray[np.float32]] = []
    outputs: list[NDArray[np.float32]] = []
    last = np.zeros(16, np.float32)
    shake, loud = np.zeros(16), rng.choice([0.0, 0.05, 0.15])
    speed = float(rng.choice([0.3, 0.5, 0.5, 0.8]))
    wish, change, push = (0.0, 0.0), 0.5, float(rng.uniform(1.0, 4.0))
    for tick in range(round(EPISODE_TIME / sim.timestep)):
        now = sim.time
        if free and now >= change:
            moving = rng.random(2) < 0.75
            wish = (float(rng.uniform(-0.8, 1.0) * moving[0]), float(rng.uniform(-0.9, 0.9) * moving[1]))
            change = now + rng.uniform(1.0, 3.0)
        if not free:
            wish = (speed, float(steering(sim.position[1], sim.yaw))) if now >= 0.5 else (0.0, 0.0)
        if now > push:
            push = now + rng.uniform(2.0, 4.0)
            way, force = rng.uniform(0.0, 2.0 * np.pi), rng.uniform(20.0, 90.0)
            sim.push((force * np.cos(way), force * np.sin(way), 0.0), 0.1)
        state = sim.low_state()
        attitude.measure(state)
        shown = teacher.step(state, VelocityCommand(0, wish[0], 0.0, wish[1]), PostureCommand(0))
        if tick % PARAMS.decimation == 0:
            frame, output = np.empty(FRAME_LENGTH, np.float32), as_output(layout, state, shown)
            up: Array = np.array(up_of(state.quaternion))
            layout.frame(state.gyro, up, np.array([wish[0], 0.0, wish[1]]), state.q, state.dq, last, frame)
            frames.append(frame)
            outputs.append(output)
            shake = 0.9 * shake + 0.44 * loud * rng.normal(size=16)
            last = np.clip(output + shake, layout.lower, layout.upper).astype(np.float32)
            held.q[:], held.dq[:] = layout.targets(last)
        sim.apply(held)
        sim.step()
        x, y, _ = sim.position.tolist()
        if sim.rotation[2, 2] < TIPPED_COSINE or abs(y) > 1.0 or not -0.75 < x < 6.9:
            break
    return np.array(frames), np.array(outputs)


def stacked(frames: NDArray[np.float32]) -> NDArray[np.float32]:
    """Observations (n, 57 k) of one drive's frames (n, 57); before its start its first frame stands."""
    index = np.arange(len(frames))
    return np.concatenate([frames[np.maximum(index - age, 0)] for age in PARAMS.ages], axis=1)
