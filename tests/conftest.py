"""The order of the test files: two workers take whole files, and a long one that begins last keeps the other waiting."""

from __future__ import annotations

import signal
from pathlib import Path

import hypothesis
import pytest

# A shell that starts the tests in the background ignores Ctrl-C, and so would every process that a test starts and interrupts.
if signal.getsignal(signal.SIGINT) == signal.SIG_IGN:
    signal.signal(signal.SIGINT, signal.default_int_handler)

hypothesis.settings.register_profile("busy", deadline=None)  # a wall clock tells nothing on a busy machine
hypothesis.settings.load_profile("busy")
LONGEST_FIRST = (
    "rbtrg_robot/process/test_live.py",
    "rbtrg_robot/hosts/test_lockstep.py",
    "rbtrg_robot/hosts/test_explore.py",
    "hal/unitree/test_dds.py",
    "rbtrg_robot/hosts/test_guard.py",
    "rbtrg_robot/process/test_cable.py",
    "rbtrg_robot/process/test_latch.py",
    "rbtrg_robot/console/test_browser.py",
    "rbtrg_robot/process/test_console_live.py",
    "rbtrg_robot/stages/test_warm_up.py",
    "rbtrg_robot/hosts/test_mission.py",
    "rbtrg_robot/hosts/test_unitree.py",
    "hal/locomotion/test_vmc.py",
    "rbtrg_robot/hosts/test_restart.py",
    "rbtrg_robot/cli/test_cli.py",
    "mapping/odometry/test_pipeline.py",
)
"""More than 15 s each on two cores; the rest follows in the order of collection."""


def pytest_configure(config: pytest.Config) -> None:
    """Otherwise pytest-xdist puts the files with the fewest tests last, which are the longest here."""
    config.option.loadscopereorder = False


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Stable: files keep their order otherwise."""
    here = Path(__file__).parent
    rank = {here / name: number for number, name in enumerate(LONGEST_FIRST)}
    items.sort(key=lambda item: rank.get(item.path, len(rank)))
