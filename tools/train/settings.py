"""Every number of the training in one place."""

from __future__ import annotations

from pydantic import BaseModel, ConfigDict, Field

from hal.robots.go2w.locomotion.rlsar import PolicyParams

PARAMS = PolicyParams(
    # Stiff: the torques of the model-based controller can be written as targets of these gains, not of softer ones.
    rl_kp=(80.0, 80.0, 40.0) * 4 + (0.0,) * 4,
    rl_kd=(3.0, 3.0, 2.0) * 4 + (1.2,) * 4,
    action_scale=(0.125, 0.2, 0.25) * 4 + (5.0,) * 4,
    default_dof_pos=(0.0, 0.8, -1.5) * 4 + (0.0,) * 4,
    clip_actions_lower=(-6.0,) * 16,
    clip_actions_upper=(6.0,) * 16,
    observations_history=(0, 2, 6, 14),
    actions_scale=0.25,
    clip_obs=5.0,
)
"""Observation, action and gains..."""
DESCRIPTION = PARAMS.described()
"""... as controllers read them."""
POLICY_LAYERS = (256, 128, 64)
"""Of the policy, ELU."""
CRITIC_LAYERS = (256, 128)


class Physics(BaseModel):
    """Simulation that is trained in: a third of the exact one's cost, and what it teaches holds there."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    timestep: float = Field(0.01, description="[s]")
    iterations: int = Field(10, description="of the solver")
    models: int = Field(16, description="robots drawn, each with its own friction, mass and gains")
    friction: tuple[float, float] = (0.3, 1.2)
    mass: tuple[float, float] = Field((-1.0, 4.0), description="added to the trunk [kg]")
    centre: float = Field(0.05, description="largest shift of the trunk's centre of mass along each axis [m]")
    gains: float = Field(0.2, description="largest change of kp and kd, as a share")
    delays: tuple[int, ...] = Field((0, 1, 2), description="time steps until a command takes effect")
    push: float = Field(0.5, description="largest kick of the trunk's velocity [m/s]")
    push_every: float = Field(4.0, description="mean time between kicks [s]")
    noise: dict[str, float] = {"gyro": 0.08, "up": 0.01, "dq": 0.2}


class Reward(BaseModel):
    """Weights, per second of 50 steps; the terms are in `environment`."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    velocity: float = 1.5
    progress: float = 1.0
    turning: float = 1.5
    alive: float = 0.3
    bounce: float = -0.5
    sway: float = -0.05
    tilt: float = -1.0
    torque: float = -2e-4
    power: float = -5e-4
    jerk: float = -0.02
    posture: float = -0.1
    hips: float = -0.5
    low: float = -2.0
    creep: float = -0.05
    scale: float = Field(0.05, description="of the sum, per step")
    fall: float = Field(-1.5, description="once")
    astray: float = Field(-0.5, description="once, for leaving the lane")


class Ppo(BaseModel):
    """Schulman et al. 2017, with the learning rate adapted to the divergence (Rudin et al. 2022)."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    robots: int = 512
    horizon: int = 24
    epochs: int = 4
    batches: int = 4
    clip: float = 0.2
    gamma: float = 0.99
    lam: float = 0.95
    entropy: float = 0.002
    rate: float = Field(3e-4, description="of the policy at the start")
    critic_rate: float = 6e-4
    divergence: float = Field(0.02, description="wanted between two policies [nat]")
    std: float = Field(0.3, description="of the first policy's outputs")
    warm: int = Field(6, description="iterations in which only the critic learns")


class Settings(BaseModel):
    """All of a run."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    seed: int = 0
    physics: Physics = Physics()
    reward: Reward = Reward()
    ppo: Ppo = Ppo()
    turning: float = Field(0.2, description="share of robots on open ground with any command")
    still: float = Field(0.15, description="share of commands that are zero, on open ground")
    episode: float = Field(10.0, description="[s]")
    first_level: int = Field(2, description="highest level at the start")


PERIOD = PARAMS.dt * PARAMS.decimation
"""Of a policy step [s]."""
