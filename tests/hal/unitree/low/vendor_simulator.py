"""The vendor's public simulator (`unitree_mujoco/simulate_python`), run as it is, without a window. For a Python that
has mujoco, pygame and the vendor's SDK (`unitree_sdk2py`, cyclonedds 0.10.2); nothing of ours is imported.

    python vendor_simulator.py FOLDER_OF_UNITREE_MUJOCO SCENE.xml DOMAIN

What it lacks is added from outside: it counts no tick, which the robot does in ms, and it has no mode switcher, which
here says that no motion service is active. On standard output comes a JSON line with the truth 20 times a second. It
ends with its standard input.
"""

import json
import os
import runpy
import sys
import time
import types

ROOT, SCENE, DOMAIN = sys.argv[1], sys.argv[2], int(sys.argv[3])
FOLDER = os.path.join(ROOT, "simulate_python")
os.chdir(FOLDER)
sys.path.insert(0, FOLDER)
os.environ["PYGAME_HIDE_SUPPORT_PROMPT"] = "1"

import config  # noqa: E402
import mujoco  # noqa: E402
from unitree_sdk2py.core import channel  # noqa: E402
from unitree_sdk2py.rpc.server import Server  # noqa: E402

config.ROBOT, config.ROBOT_SCENE, config.DOMAIN_ID, config.INTERFACE = "go2w", SCENE, DOMAIN, "lo"
config.USE_JOYSTICK = config.PRINT_SCENE_INFORMATION = False


class Screen:
    """In place of the window."""

    on = True

    def is_running(self):
        return self.on

    def sync(self):
        """Nothing is drawn."""


screen = Screen()
mujoco.viewer = types.SimpleNamespace(launch_passive=lambda *_args, **_more: screen)
sys.modules["mujoco.viewer"] = mujoco.viewer

write = channel.ChannelPublisher.Write
began = time.monotonic()


def ticking(self, sample, timeout=None):
    """With the milliseconds since the robot was switched on."""
    if hasattr(sample, "tick"):
        sample.tick = int(1000.0 * (time.monotonic() - began))
    return write(self, sample, timeout)


channel.ChannelPublisher.Write = ticking


class ModeSwitcher(Server):
    """No motion service is active."""

    def __init__(self):
        super().__init__("motion_switcher")

    def Init(self):
        self._RegistHandler(1001, lambda _parameter: (0, json.dumps({"form": "0", "name": ""})), False)
        self._SetApiVersion("1.0.0.1")


told = os.fdopen(os.dup(1), "w")
os.dup2(2, 1)  # what they print is no report
simulator = runpy.run_path(os.path.join(FOLDER, "unitree_mujoco.py"), run_name="__main__")
time.sleep(0.5)
server = ModeSwitcher()
server.Init()
server.Start(False)
data = simulator["mj_data"]
os.set_blocking(0, False)
while True:
    w, x, y, z = data.qpos[3:7]
    state = {
        "t": float(data.time),
        "x": float(data.qpos[0]),
        "y": float(data.qpos[1]),
        "z": float(data.qpos[2]),
        "up": float(1.0 - 2.0 * (x * x + y * y)),
        "yaw_sine": float(2.0 * (w * z + x * y)),
        "v": float((data.qvel[0] ** 2 + data.qvel[1] ** 2) ** 0.5),
        "wz": float(data.qvel[5]),
        "torque": float(abs(data.ctrl).max()),
    }
    told.write(json.dumps(state) + "\n")
    told.flush()
    time.sleep(0.05)
    try:
        if os.read(0, 64) == b"":
            screen.on = False
            os._exit(0)
    except BlockingIOError:
        pass
