"""The whole stack before what no LiDAR sees: it stands, tells of it, and goes around."""

from __future__ import annotations

import pytest

from hal.safety.monitors import taken_out
from tools.bench.faults.contact import FAULTS, go_round, pane, push

BY_NAME = {fault.name: fault for fault in FAULTS}


@pytest.mark.parametrize(
    ("degrees", "controller"), [(0.0, "hybrid"), pytest.param(60.0, "vmc", marks=pytest.mark.campaign)]
)
def test_by_hand_it_stands_at_a_pane_of_glass(degrees: float, controller: str) -> None:
    outcome = push(pane(degrees), controller, 0.5, 2)  # type: ignore[arg-type]
    assert not BY_NAME["contact.pane"].missed(outcome)
    assert outcome.moved < 0.3


@pytest.mark.campaign
def test_to_a_goal_behind_a_pane_it_goes_around() -> None:
    outcome = go_round(pane(0.0), "hybrid", 2)
    assert not BY_NAME["contact.pane_round"].missed(outcome)


@pytest.mark.campaign
def test_without_the_monitor_nobody_is_told() -> None:
    with taken_out("touched"):
        outcome = push(pane(0.0), "vmc", 0.5, 2)
    assert "nobody said" in BY_NAME["contact.pane"].missed(outcome)
