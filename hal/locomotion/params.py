"""Gains and limits of the virtual model controller. One flat tuple of floats: it goes into the compiled kernels as it is."""

from __future__ import annotations

from typing import NamedTuple


class VmcParams(NamedTuple):
    """Defaults hold for the 19.5 kg Go2-W at 100 to 500 Hz."""

    # --- trunk
    height: float = 0.385
    """Default height of base_link above the ground plane [m]; leaves 0.1 m of leg stroke down and 0.18 m up."""
    max_level: float = 0.38
    """Ground slope [rad] up to which the trunk is kept level; beyond it leans with the excess."""
    heave_k: float = 900.0
    """[N/m]"""
    heave_d: float = 60.0
    """[N s/m], on top of the motors' own damping."""
    roll_k: float = 260.0
    """[Nm/rad]"""
    roll_d: float = 6.0
    """[Nm s/rad], on top of the motors' own damping."""
    pitch_k: float = 260.0
    pitch_d: float = 8.0
    trim: float = 0.5
    """Rate [1/s] at which load the model does not know (payload) is learnt from the height error."""
    force_max: float = 170.0
    """Highest vertical wheel force asked for [N]."""
    lookahead: float = 0.010
    """Time [s] by which the attitude is extrapolated with the gyro: half of the loop delay to be tolerated."""

    # --- legs
    leg_kp: float = 120.0
    """Hip and thigh position gain [Nm/rad], closed in the motor: holds the wheels under the trunk."""
    leg_kd: float = 2.0
    """Damping of hip, thigh and calf [Nm s/rad], closed in the motor, so that it suffers no delay."""
    stroke_min: float = 0.12
    """Axle below hip [m] where the folded leg's soft stop ends."""
    stroke_max: float = 0.392
    """Axle below hip [m] where the stretched leg's soft stop ends."""

    # --- wheels
    wheel_kd: float = 1.2
    """Wheel speed gain [Nm s/rad], closed in the motor."""
    wheel_torque: float = 6.0
    """Largest torque the speed loop may add to the feed-forward [Nm]."""
    wheel_kp: float = 12.0
    """Position gain [Nm/rad] of a wheel that holds its place."""
    speed_ki: float = 4.0
    """Common speed integral [Nm/m]."""
    accel: float = 1.5
    """Slew of the commanded speed [m/s^2]."""
    alpha: float = 4.0
    """Slew of the commanded yaw rate [rad/s^2]."""
    yaw_kp: float = 1.5
    yaw_ki: float = 8.0
    """Yaw-rate loop on the gyro, acting on the wheel speed difference [-], [1/s]."""
    turn_pull: float = 0.09
    """How far each axle moves inwards for a full turn [m]: a short wheelbase skids round easily."""
    turn_full: float = 0.35
    """Yaw rate [rad/s] from which the axles are pulled in fully."""
    place_rate: float = 0.30
    """Speed of wheel placement relative to the trunk [m/s]."""

    # --- contact
    contact_on: float = 14.0
    """Vertical force [N] above which a wheel counts as loaded."""
    contact_off: float = 6.0
    force_filter: float = 0.02
    """Time constant of the contact force estimate [s]."""
    slope_filter: float = 0.10
    """Time constant of the ground plane estimate [s]."""
    nose_up: float = 0.30
    """Pitch [rad] above the wanted one at which drive torque is cut to zero, against wheelies."""
