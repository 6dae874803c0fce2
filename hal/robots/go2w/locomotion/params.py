"""Gains and limits of the virtual model controller, all floats. The compiled kernels take them as one record."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np


class VmcParams(NamedTuple):
    """Defaults hold for the 19.5 kg Go2-W at 100 to 500 Hz."""

    # --- trunk
    height: float = 0.385
    """Default height of base_link above the ground plane [m]; leaves 0.1 m of leg stroke down and 0.18 m up."""
    level_roll: float = 0.38
    """Side slope of the ground [rad] up to which the trunk is kept level; beyond it leans with the excess."""
    level_pitch: float = 0.20
    """The same along the trunk; less, because the legs need their stroke to climb steps."""
    heave_k: float = 900.0
    """[N/m]"""
    heave_d: float = 60.0
    """[N s/m], on top of the motors' own damping."""
    roll_k: float = 200.0
    """[Nm/rad]"""
    roll_d: float = 6.0
    """[Nm s/rad], on top of the motors' own damping."""
    pitch_k: float = 200.0
    pitch_d: float = 14.0
    trim: float = 1.0
    """Rate [1/s] at which load the model does not know (payload) is learnt from the height error."""
    force_max: float = 170.0
    """Highest vertical wheel force asked for [N]."""
    lookahead: float = 0.020
    """Time [s] by which the attitude is extrapolated with the gyro: half of the loop delay to be tolerated."""

    # --- legs
    leg_kp: float = 110.0
    """Hip and thigh position gain [Nm/rad], closed in the motor: holds the wheels under the trunk."""
    leg_kd: float = 6.0
    """Damping of the thigh [Nm s/rad], closed in the motor, so that it suffers no delay."""
    hip_kd: float = 4.0
    """Of the hip. With 6 it rings where the motor's law is computed every 5 ms, as in the vendor's simulator."""
    halt_sway: float = 30.0
    """Rate [1/s] at which a robot that is told to stand brakes its sideways motion: after a curve it sways. In turns it
    would cost yaw rate."""
    calf_kd: float = 2.0
    calf_share: float = 1.0
    """Share of the calf in holding a wheel's place; 1 makes that force horizontal."""
    stroke_min: float = 0.12
    """Axle below hip [m] where the folded leg's soft stop ends."""
    stroke_max: float = 0.392
    """Axle below hip [m] where the stretched leg's soft stop ends."""

    # --- wheels
    wheel_kd: float = 1.2
    """Wheel speed gain [Nm s/rad], closed in the motor."""
    wheel_torque: float = 6.0
    """Largest torque the speed loop may add to the feed-forward [Nm]."""
    wheel_kp: float = 18.0
    """Position gain [Nm/rad] of a wheel that holds its place."""
    speed_ki: float = 4.0
    """Common speed integral [Nm/m]."""
    accel: float = 2.5
    """Slew of the commanded speed [m/s^2]."""
    decel: float = 4.0
    """The same while braking [m/s^2]; ground with less friction than 0.4 lets the wheels slide."""
    alpha: float = 4.0
    """Slew of the commanded yaw rate [rad/s^2]."""
    yaw_kp: float = 2.5
    yaw_ki: float = 10.0
    """Yaw-rate loop on the gyro, acting on the wheel speed difference [-], [1/s]."""
    turn_pull: float = 0.03
    """Inward shift of each axle for a full turn [m]: a short wheelbase skids round easily, and tips over edges
    easily."""
    hill_pull: float = 0.09
    """The same on hillsides, where turning asks for more [m]."""
    turn_full: float = 0.35
    """Yaw rate [rad/s] from which the axles are pulled in fully."""
    turn_jam: float = 20.0
    """Force [N] of an edge on a wheel, beyond what friction explains, at which turning on the spot has stopped."""
    turn_strain: float = 0.08
    """Largest drag [m] of a wheel from its place under the trunk by turning on the spot; slower from 0.6 of it on."""
    astray: float = 0.03
    """How far [m] a wheel may be from its place under the trunk before it rolls back to it..."""
    astray_rate: float = 5.0
    """... at this speed for every metre beyond [1/s]."""
    place_rate: float = 0.40
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

    # --- climbing with one wheel at a time
    climb: float = 1.0
    """0 switches it off."""
    blocked_force: float = 30.0
    """Backward force on a wheel, compared with the mean of the others, that means blocked [N]."""
    brake: float = 200.0
    """How fast the robot stops to climb [m/s^2]."""
    still: float = 0.20
    """Speed [m/s] below which a wheel may be lifted."""
    blocked_lag: float = 0.07
    """How far a wheel may fall behind its place under the trunk [m]."""
    blocked_time: float = 0.12
    """[s]"""
    triangle: float = 0.22
    """How far the centre of mass moves from the edge of the support triangle towards its far corner, as a share."""
    shift_bandwidth: float = 18.0
    """Of the critically damped weight shift [rad/s]."""
    shift_back: float = 6.0
    """The same when the climb is over [rad/s]."""
    shift_accel: float = 4.0
    """[m/s^2]"""
    shift_miss: float = 0.03
    """Rest of the weight shift [m] at which lifting may begin."""
    shift_margin: float = 0.0
    """How far [m] the centre of mass must be inside the support triangle before the wheel is lifted."""
    shift_time: float = 0.1
    """Shortest time for unloading the wheel [s]."""
    lift_tilt: float = 0.14
    """Roll or pitch off the wanted one [rad] from which no wheel is lifted."""
    lift_swing: float = 0.4
    """The same for roll and pitch rate [rad/s]."""
    stroke_lift: float = 0.125
    """Axle below hip of the lifted wheel [m]."""
    lift_rate: float = 1.6
    """[m/s]"""
    retreat: float = 0.02
    """How far the wheel backs off from the face while it is lifted [m]."""
    reach: float = 0.16
    """How far beyond the place where it was blocked the wheel is put down [m]."""
    reach_max: float = 0.20
    """Furthest ahead of the hip [m]."""
    reach_rate: float = 1.4
    lower_rate: float = 1.0
    """[m/s]"""
    swing_kp: float = 120.0
    """Joint gain of the lifted leg [Nm/rad]."""
    load_rate: float = 600.0
    """How fast a wheel that was put down takes load [N/s]."""

    # --- feeling for edges
    creep: float = 0.105
    """Commanded speed [m/s] up to which the robot stops at edges that go down; 0 switches it off."""
    edge_lean: float = 0.42
    """How far [rad] from the hill's normal the ground must push a leading wheel forward to be an edge."""


RECORD = np.dtype([(name, "f8") for name in VmcParams._fields])
"""What the kernels take: a tuple is taken apart and checked float by float at every call."""
