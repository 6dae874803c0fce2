"""Checks of this machine: is everything there that the stack needs?"""

from __future__ import annotations

import importlib
import os
import resource
import shutil
import socket
import subprocess
import sys
import time
from collections.abc import Iterator
from dataclasses import dataclass
from enum import Enum
from pathlib import Path

from hal.errors import one_line
from hal.optional import INSTALL_DDS, INSTALL_SIMULATOR, open3d_hint
from hal.unitree.link import RECEIVE_BUFFER

REQUIRED = ("zenoh", "numpy", "numba", "kiss_icp", "mcap", "pydantic", "typer", "rosbags")
SHM_BYTES = 256 * 1024 * 1024
DISK_BYTES = 2 * 1024**3
OPEN_FILES = 1024
RMEM_MAX = Path("/proc/sys/net/core/rmem_max")
"""Most bytes that the kernel gives to a socket which asks for a receive buffer."""


class Level(Enum):
    """Severity of a finding."""

    OK = 0
    NOTE = 1
    """Works, but less well."""
    FAULT = 2


@dataclass(frozen=True, slots=True)
class Finding:
    """One check."""

    what: str
    level: Level
    words: str


def examine(port: int) -> Iterator[Finding]:
    """All checks, in order."""
    yield _python()
    yield from (_library(name) for name in REQUIRED)
    yield _simulator()
    yield _open3d()
    yield _unitree()
    yield _receive_buffer()
    yield _port(port)
    yield _shared_memory()
    yield _disk()
    yield _files()
    yield _cores()
    yield _clock()
    yield _rendering()


def _python() -> Finding:
    have = ".".join(map(str, sys.version_info[:3]))
    return Finding("python", Level.OK, have)


def _library(name: str) -> Finding:
    try:
        importlib.import_module(name)
    except Exception as error:  # noqa: BLE001 - whatever stops an import is the finding
        return Finding(name, Level.FAULT, f"does not import ({error}); reinstall with `uv sync`")
    return Finding(name, Level.OK, "imports")


def _simulator() -> Finding:
    try:
        importlib.import_module("mujoco")
    except Exception as error:  # noqa: BLE001 - whatever stops an import is the finding
        words = f"no simulated robot ({one_line(error)}); for one: {INSTALL_SIMULATOR}"
        return Finding("simulator", Level.NOTE, words)
    return Finding("simulator", Level.OK, "MuJoCo imports")


def _open3d() -> Finding:
    # In a process of its own: a broken graphics library may take the importer down with it.
    done = subprocess.run(
        [sys.executable, "-c", "import open3d"], capture_output=True, text=True, timeout=120, check=False
    )
    if done.returncode == 0:
        return Finding("open3d", Level.OK, "imports; mesh scenes with ceilings and bridges can be simulated")
    reason = (done.stderr.strip().splitlines() or ["it crashes"])[-1]
    error = ModuleNotFoundError(reason) if "ModuleNotFoundError" in reason else ImportError(reason)
    return Finding(
        "open3d",
        Level.NOTE,
        f"only mesh scenes with ceilings or bridges need it: {open3d_hint(error)}",
    )


def _unitree() -> Finding:
    try:
        importlib.import_module("cyclonedds.core")
    except Exception as error:  # noqa: BLE001 - whatever stops an import is the finding
        return Finding("unitree", Level.NOTE, f"no DDS ({one_line(error)}); for a real robot: {INSTALL_DDS}")
    return Finding("unitree", Level.OK, "DDS imports")


def _receive_buffer() -> Finding:
    what = "receive buffer"
    try:
        most = int(RMEM_MAX.read_text())
    except OSError:
        return Finding(what, Level.NOTE, f"{RMEM_MAX} cannot be read; a LiDAR's sweeps over DDS may be lost")
    if most < RECEIVE_BUFFER:
        words = f"net.core.rmem_max is {most}: a real robot's LiDAR sweeps (0.8 MB) may be lost on the way"
        return Finding(what, Level.NOTE, f"{words}; sysctl -w net.core.rmem_max={RECEIVE_BUFFER}")
    return Finding(what, Level.OK, f"net.core.rmem_max is {most}")


def _port(port: int) -> Finding:
    with socket.socket() as probe:
        probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        try:
            probe.bind(("127.0.0.1", port))
        except OSError:
            return Finding(
                "port",
                Level.FAULT,
                f"{port} on 127.0.0.1 is taken: is a stack up? Otherwise use `up --port N`",
            )
    return Finding("port", Level.OK, f"{port} on 127.0.0.1 is free")


def _shared_memory() -> Finding:
    try:
        free = shutil.disk_usage("/dev/shm").free
    except OSError:
        return Finding("shared memory", Level.NOTE, "/dev/shm is missing; large messages travel by socket")
    left = list(Path("/dev/shm").glob("*.zenoh*"))
    size = sum(f.stat().st_size for f in left)
    if free < SHM_BYTES:
        return Finding(
            "shared memory", Level.FAULT, f"{free // 2**20} MB free in /dev/shm, 256 MB are needed"
        )
    extra = f", {len(left)} segments of {size // 2**20} MB in use or left behind" if left else ""
    return Finding("shared memory", Level.OK, f"{free // 2**20} MB free{extra}")


def _disk() -> Finding:
    free = shutil.disk_usage(".").free
    if free < DISK_BYTES:
        return Finding(
            "disk", Level.FAULT, f"{free // 2**20} MB free here; a log needs about 1 GB per 10 minutes"
        )
    return Finding("disk", Level.OK, f"{free // 2**30} GB free here for logs")


def _files() -> Finding:
    soft, _hard = resource.getrlimit(resource.RLIMIT_NOFILE)
    if soft < OPEN_FILES:
        return Finding("open files", Level.FAULT, f"limit {soft}; raise it with `ulimit -n {OPEN_FILES}`")
    return Finding("open files", Level.OK, f"limit {soft}")


def _cores() -> Finding:
    cores = len(os.sched_getaffinity(0))
    if cores < 2:
        return Finding("processor", Level.NOTE, "one core; the simulator will not keep real time")
    return Finding("processor", Level.OK, f"{cores} cores")


def _clock() -> Finding:
    now = time.time()
    if now < 1_700_000_000:
        return Finding("clock", Level.FAULT, f"says {time.ctime(now)}; set the date before logging anything")
    longest = 0.0
    for _ in range(20):
        began = time.monotonic()
        time.sleep(0.001)
        longest = max(longest, time.monotonic() - began)
    if longest > 0.02:
        return Finding(
            "clock", Level.NOTE, f"a 1 ms sleep took {1000 * longest:.0f} ms: the machine is loaded"
        )
    return Finding("clock", Level.OK, f"{time.ctime(now)}, sleeps within {1000 * longest:.1f} ms")


def _rendering() -> Finding:
    code = (
        "import mujoco; m = mujoco.MjModel.from_xml_string('<mujoco/>'); mujoco.Renderer(m, 32, 32).close()"
    )
    for backend, words in (("egl", "EGL"), ("osmesa", "OSMesa (slow)")):
        environment = {**os.environ, "MUJOCO_GL": backend}
        done = subprocess.run(
            [sys.executable, "-c", code], capture_output=True, timeout=120, check=False, env=environment
        )
        if done.returncode == 0:
            return Finding("rendering", Level.OK, f"off-screen through {words}")
    return Finding(
        "rendering",
        Level.NOTE,
        "no off-screen rendering; pictures and --render will not work. "
        "On Debian or Ubuntu: apt-get install libegl1 libgl1",
    )
