"""LowState into `hal.lowlevel.LowState`, and `hal.lowlevel.LowCommand` into LowCmd, both in the robot's motor order.

Source: unitree_go IDL of unitree_sdk2, `example/go2w` and `utils/crc.py` of unitree_sdk2_python for the head, the modes
and the checksum.
"""

from __future__ import annotations

import math

import numpy as np

from hal.lowlevel import LowCommand, LowState
from hal.robots.go2w import facts as go2w
from hal.unitree.layout import CDR_HEADER, LOW_CMD_CDR, low_cmd_checksum

LOW_CMD = "rt/lowcmd"
MOTORS = len(go2w.MOTORS)
"""Of the twenty slots in a message; the others stay off."""
HEAD = (0xFE, 0xEF)
LOW_LEVEL = 0xFF
"""`level_flag`: this command goes to the motors."""
FOC = 0x01
"""`mode` of a motor that follows; 0 is off."""
L2, B = 1 << 5, 1 << 9
"""Bits of the remote's keys, bytes 2 and 3 of `wireless_remote`: R1, L1, start, select, R2, L2, F1, F2, A, B, X, Y, up,
right, down, left."""
_SOFT = L2 | B


def low_state(low: np.void, time: float, imu_yaw: float = 0.0) -> LowState:
    """A LowState message as controllers read it, at `time` [s].

    imu_yaw [rad]: of the IMU in base_link. The quaternion in the message is w, x, y, z, world <- IMU.
    """
    motors, imu = low["motor_state"], low["imu_state"]
    q, dq, tau = (motors[name][:MOTORS].astype(np.float64) for name in ("q", "dq", "tau_est"))
    w, x, y, z = (float(v) for v in imu["quaternion"])
    gyro, accel = imu["gyroscope"].astype(np.float64), imu["accelerometer"].astype(np.float64)
    if imu_yaw:
        c, s = math.cos(imu_yaw / 2), math.sin(imu_yaw / 2)
        # world <- base_link = (world <- IMU)(IMU <- base_link)
        w, x, y, z = w * c + z * s, x * c - y * s, y * c + x * s, z * c - w * s
        c, s = math.cos(imu_yaw), math.sin(imu_yaw)
        turn = np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
        gyro, accel = turn @ gyro, turn @ accel
    return LowState(time, q, dq, tau, np.array([w, x, y, z]), gyro, accel)


def wants_soft(low: np.void) -> bool:
    """Whether L2 and B are pressed on the robot's own remote: the vendor's emergency stop, joints soft."""
    keys = int(low["wireless_remote"][2]) | int(low["wireless_remote"][3]) << 8
    return keys & _SOFT == _SOFT


class Packer:
    """Writes LowCmd messages; one array is reused."""

    def __init__(self) -> None:
        self._record = np.zeros(1, LOW_CMD_CDR)
        message = self._record[0]
        message["head"], message["level_flag"] = HEAD, LOW_LEVEL
        message["motor_cmd_first_mode"] = FOC
        message["motor_cmd_modes"]["mode"][: MOTORS - 1] = FOC
        self._motors = self._record["motor_cmd"][0]

    def pack(self, command: LowCommand) -> bytes:
        """CDR with encapsulation header and checksum. The caller has made sure that every value is finite."""
        for name in ("q", "dq", "tau", "kp", "kd"):
            self._motors[name][:MOTORS] = getattr(command, name)
        self._record["crc"] = low_cmd_checksum(CDR_HEADER + self._record.tobytes())
        return CDR_HEADER + self._record.tobytes()
