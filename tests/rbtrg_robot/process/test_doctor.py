"""What the doctor finds on a machine."""

from __future__ import annotations

from pathlib import Path

import pytest

from rbtrg_robot.process import doctor
from rbtrg_robot.process.doctor import Level


@pytest.mark.parametrize(
    ("most", "level"), [("212992\n", Level.NOTE), ("4194304\n", Level.OK), (None, Level.NOTE)]
)
def test_a_receive_buffer_too_small_for_a_sweep_is_found(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, most: str | None, level: Level
) -> None:
    monkeypatch.setattr(doctor, "RMEM_MAX", tmp_path / "rmem_max")
    if most is not None:
        doctor.RMEM_MAX.write_text(most)
    finding = doctor._receive_buffer()
    assert finding.level is level
    assert ("sysctl -w net.core.rmem_max=4194304" in finding.words) == (most == "212992\n")
