"""The order of the test files: two workers take whole files, and a long one that begins last keeps the other waiting."""

from __future__ import annotations

import pytest

LONGEST_FIRST = (
    "test_live.py",
    "test_lockstep_explore.py",
    "test_unitree_dds.py",
    "test_lockstep.py",
    "test_warm_up.py",
    "test_cli.py",
    "test_lockstep_unitree.py",
    "test_vmc.py",
    "test_graph_update.py",
    "test_odometry.py",
    "test_lockstep_restart.py",
)
"""More than 15 s each on two cores; the rest follows in the order of collection."""


def pytest_configure(config: pytest.Config) -> None:
    """Otherwise pytest-xdist puts the files with the fewest tests last, which are the longest here."""
    config.option.loadscopereorder = False


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Stable: files keep their order otherwise."""
    rank = {name: number for number, name in enumerate(LONGEST_FIRST)}
    items.sort(key=lambda item: rank.get(item.path.name, len(rank)))
