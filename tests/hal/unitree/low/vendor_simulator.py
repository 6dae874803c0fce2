"""The vendor's public simulator (`unitree_mujoco/simulate_python`), run as it is, without a window. For a Python that
has mujoco, pygame and the vendor's SDK (`unitree_sdk2py`, cyclonedds 0.10.2); nothing of ours is imported.

    python vendor_simulator.py FOLDER_OF_UNITREE_MUJOCO SCENE.xml DOMAIN

What it lacks is added from outside: it counts no tick, which the robot does in ms, and it has no mode switcher, which
here says that no motion service is active. It keeps ten commands in a queue: on a busy machine the motors would follow
one of 20 ms ago. Here a step tells its state and the next one waits for commands that answer it, so that a busy machine
is slower and nothing else. On standard output comes a JSON line with the truth 20 times a second of its own time. It
ends with its standard input.
"""

import json
import os
import queue
import runpy
import sys
import threading
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
from unitree_sdk2py.utils import thread  # noqa: E402

config.ROBOT, config.ROBOT_SCENE, config.DOMAIN_ID, config.INTERFACE = "go2w", SCENE, DOMAIN, "lo"
config.USE_JOYSTICK = config.PRINT_SCENE_INFORMATION = False


class Screen:
    """In place of the window."""

    def is_running(self):
        return True

    def sync(self):
        """Nothing is drawn."""


mujoco.viewer = types.SimpleNamespace(launch_passive=lambda *_args, **_more: Screen())
sys.modules["mujoco.viewer"] = mujoco.viewer

ANSWERS, PATIENCE = 3, 0.02
"""A step waits for so many commands after a state, since the first may have been sent before it came; [s] at most: a
motor loop that is dead sends none."""
TOLD_EVERY = 10
"""Steps between two lines of truth."""
STARTS_WITHIN = 30.0
"""[s]"""

answers, stepped = queue.SimpleQueue(), threading.Event()
step, subscribe, write = mujoco.mj_step, channel.ChannelSubscriber.Init, channel.ChannelPublisher.Write
tell_state = None
now = 0.0
"""[s] of the simulation."""


def following(self, handler=None, queue_length=0):
    """The newest command at once, instead of the oldest of a queue."""
    if handler is None or handler.__name__ != "LowCmdHandler":
        return subscribe(self, handler, queue_length)

    def follow(sample):
        handler(sample)
        answers.put(None)

    return subscribe(self, follow)


class Recurrent(thread.RecurrentThread):
    """LowState is told by `answered`, and not by a clock of its own."""

    def __init__(self, interval=1.0, target=None, name=None):
        global tell_state
        self.kept = target.__name__ == "PublishLowState"
        tell_state = target if self.kept else tell_state
        super().__init__(interval, target, name)

    def Start(self):
        if not self.kept:
            super().Start()


def answered(model, data):
    """A step when the last state was answered; then the state."""
    global now
    deadline = time.monotonic() + PATIENCE
    try:
        for _ in range(ANSWERS):
            answers.get(timeout=max(0.0, deadline - time.monotonic()))
    except queue.Empty:
        pass
    step(model, data)
    now = data.time
    stepped.set()
    while not answers.empty():
        answers.get()
    tell_state()
    if round(now / model.opt.timestep) % TOLD_EVERY == 0:
        tell_truth(data)


def ticking(self, sample, timeout=None):
    """With the milliseconds since the robot was switched on."""
    if hasattr(sample, "tick"):
        sample.tick = round(1000.0 * now)
    return write(self, sample, timeout)


mujoco.mj_step, thread.RecurrentThread = answered, Recurrent
channel.ChannelSubscriber.Init, channel.ChannelPublisher.Write = following, ticking


class ModeSwitcher(Server):
    """No motion service is active."""

    def __init__(self):
        super().__init__("motion_switcher")

    def Init(self):
        self._RegistHandler(1001, lambda _parameter: (0, json.dumps({"form": "0", "name": ""})), False)
        self._SetApiVersion("1.0.0.1")


told = os.fdopen(os.dup(1), "w")
os.dup2(2, 1)  # what they print is no report


def tell_truth(data):
    """A line of it."""
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


runpy.run_path(os.path.join(FOLDER, "unitree_mujoco.py"), run_name="__main__")
if not stepped.wait(STARTS_WITHIN):
    sys.exit("the simulator does not step")
server = ModeSwitcher()
server.Init()
server.Start(False)
sys.stdin.read()
os._exit(0)
