"""The order of the test files: workers take whole files, and a long one that begins last keeps the others waiting.

Tests of processes wait for them a part of their time, so files that wait and files that compute take turns. With a
third worker on two cores, beside another program, three tests in the browser failed.
"""

from __future__ import annotations

import gc
import signal
from collections.abc import Generator
from pathlib import Path

import hypothesis
import pytest

# A shell that starts the tests in the background ignores Ctrl-C, and so would every process that a test starts and
# interrupts.
if signal.getsignal(signal.SIGINT) == signal.SIG_IGN:
    signal.signal(signal.SIGINT, signal.default_int_handler)

# A wall clock tells nothing on a busy machine, and what failed once must fail again.
hypothesis.settings.register_profile("busy", deadline=None, derandomize=True)
hypothesis.settings.load_profile("busy")
LONGEST_FIRST = (
    "rbtrg_robot/process/test_live.py",
    "rbtrg_robot/console/test_browser.py",
    "hal/unitree/test_dds.py",
    "tools/bench/test_short_runs.py",
    "hal/unitree/test_backend.py",
    "hal/unitree/test_contract.py",
    "tools/bench/test_spread.py",
    "rbtrg_robot/hosts/test_closing.py",
    "test_tutorial.py",
    "test_extend.py",
    "rbtrg_robot/process/test_zygote.py",
    "hal/robots/go2w/locomotion/test_vmc.py",
    "rbtrg_robot/hosts/test_guard.py",
    "rbtrg_robot/hosts/test_lockstep.py",
    "hal/mujoco/test_backend.py",
    "hal/unitree/low/test_low.py",
    "rbtrg_robot/console/test_steps.py",
    "rbtrg_robot/test_bounds.py",
    "mapping/odometry/test_inputs_that_lie.py",
    "hal/unitree/low/test_processes.py",
    "rbtrg_robot/process/test_latch.py",
    "rbtrg_robot/hosts/test_map_build.py",
    "rbtrg_robot/hosts/test_lidars.py",
    "rbtrg_robot/cli/test_cli.py",
    "tools/bench/test_envelope.py",
    "mapping/closing/test_close.py",
    "rbtrg_robot/hosts/test_rerun.py",
    "hal/robots/go2w/locomotion/test_hybrid.py",
    "hal/mujoco/test_contract.py",
    "rbtrg_robot/hosts/test_creep.py",
    "planning/search/test_plan.py",
    "mapping/odometry/test_intake.py",
    "rbtrg_robot/hosts/test_look.py",
    "rbtrg_robot/hosts/test_hostile_sensors.py",
)
"""More than 10 s each."""
WAITING = ("access", "bridge", "cli", "console", "process", "unitree", "wire")
"""Rooms whose tests wait for processes, sockets and browsers."""


def pytest_addoption(parser: pytest.Parser) -> None:
    """`python -m tools.perturb` sets it."""
    parser.addoption(
        "--noise", type=int, default=0, help="draw the simulated sensors' noise anew; 0: as always"
    )


def pytest_configure(config: pytest.Config) -> None:
    """Otherwise pytest-xdist puts the files with the fewest tests last, which are the longest here."""
    config.option.loadscopereorder = False
    if noise := config.getoption("noise"):
        _draw_noise_anew(noise)


@pytest.hookimpl(wrapper=True)
def pytest_collection() -> Generator[None, object, object]:
    """Imports and test items stay for good: the search for garbage among them takes a quarter of the collection."""
    gc.disable()
    try:
        return (yield)
    finally:
        gc.enable()


def _draw_noise_anew(noise: int) -> None:
    """Other noise in every sample of the simulated sensors; robot, scene and friction stay."""
    from hal.mujoco.backend import MujocoBackend

    connect = MujocoBackend.connect

    def perturbed(backend: MujocoBackend) -> None:
        own, backend._seed = backend._seed, backend._seed + 1000 * noise
        connect(backend)
        backend._seed = own

    MujocoBackend.connect = perturbed  # type: ignore[method-assign]


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """The longest first; the others in the order of collection, those that wait spread evenly among those that
    compute."""
    here = Path(__file__).parent
    files = list(dict.fromkeys(item.path for item in items))
    place = {here / name: float(number - len(LONGEST_FIRST)) for number, name in enumerate(LONGEST_FIRST)}
    for waits in (True, False):
        kind = [file for file in files if file not in place and (file.parent.name in WAITING) is waits]
        shares = {file: number / len(kind) for number, file in enumerate(kind)}
        place |= shares
    items.sort(key=lambda item: place[item.path])
