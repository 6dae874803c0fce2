"""The state of the virtual model controller."""

from __future__ import annotations

import numpy as np

MEMORY = np.dtype(
    [
        ("ticks", "i8"),
        ("vx", "f8"),  # slewed command [m/s]
        ("wz", "f8"),  # [rad/s]
        ("speed", "f8"),  # estimated ground speed [m/s]
        ("speed_i", "f8"),  # common wheel torque of the speed integral [Nm]
        ("yaw_i", "f8"),  # yaw-rate integral [rad/s]
        ("lag", "f8", (4, 2)),  # of each wheel behind its place under the trunk, H [m]
        ("jam", "f8"),  # force on the wheel that is held most, beyond friction [N]
        ("strain", "f8"),  # furthest lag of a wheel against the mean of all [m]
        ("lift_i", "f8"),  # learnt extra load [N]
        ("tilt", "f8", (2,)),  # roll and pitch beyond the wanted ones [rad]
        ("slope_x", "f8"),  # ground plane, filtered
        ("slope_y", "f8"),
        ("grade", "f8", (2,)),  # the same over about a second: the hill, not the obstacle
        ("height", "f8"),  # base_link above the ground plane [m]
        ("hold", "i8"),  # wheels latched in place
        ("latch", "f8", (4,)),  # their rolled angle [rad]
        ("place", "f8", (4, 2)),  # wheel placement relative to nominal, slewed [m]
        ("force", "f8", (4, 3)),  # contact force on the wheel, H [N]
        ("contact", "i8", (4,)),
        ("load", "f8", (4,)),  # commanded vertical force [N]
        ("load_cap", "f8", (4,)),  # its upper bound after touch-down [N]
        ("skid", "f8"),  # yaw rate the wheels roll at beyond the trunk's own [rad/s]
        ("slips", "i8", (4,)),
        ("friction", "f8", (4,)),  # of each wheel, learnt from slip
        ("grip", "f8", (4,)),  # torque each wheel may have by it [Nm]
        ("mode", "i8"),  # of the climb, see hal.robots.go2w.locomotion.climb
        ("leg", "i8"),  # lifted
        ("queued", "i8"),  # lifted next, or -1
        ("way", "f8"),  # +1 climbing forward, -1 backward
        ("timer", "f8"),  # in this mode [s]
        ("retreat", "f8"),  # still to drive back after a climb without footing [s]
        ("blocked", "f8", (4,)),  # for how long [s]
        ("pace", "f8"),  # ground speed in the wanted direction, filtered [m/s]
        ("turned", "f8"),  # turning rate wanted, filtered like it [rad/s]
        ("asked", "f8"),  # wanted speed, filtered like it: a robot that only sets off is not stuck [m/s]
        ("shift_goal", "f8", (2,)),  # wheels relative to the trunk [m]
        ("shift", "f8", (2,)),
        ("shift_rate", "f8", (2,)),  # [m/s]
        ("foot", "f8", (3,)),  # wanted centre of the lifted wheel, H [m]
        ("lift_x", "f8"),  # where it was blocked [m]
        ("creep", "f8"),  # for how long the command has been slow [s], see hal.robots.go2w.locomotion.cliff
        ("lean", "f8", (4,)),  # of the ground's normal at each wheel, forward [rad]
        ("hang", "f8", (4,)),  # for how long each leg has hung [s]
        ("cliff", "f8"),  # +1 an edge ahead, -1 behind, 0 none
        ("back_off", "f8"),  # still to go from it [m]
    ]
)
"""What the controller remembers between ticks."""
