"""`docs/tutorial.ipynb` runs from its first cell to its last, and shows what it says."""

from __future__ import annotations

import re
from pathlib import Path

import nbformat
from nbclient import NotebookClient

from tests.places import ROOT


def test_the_notebook_plans_drives_and_runs_its_log_again(tmp_path: Path) -> None:
    notebook = nbformat.read(ROOT / "docs" / "tutorial.ipynb", as_version=4)
    code = [cell for cell in notebook.cells if cell.cell_type == "code"]
    assert not any(cell.outputs for cell in code), "kept without outputs: they are binary"
    five = next(cell.source for cell in code if "of_array" in cell.source)
    assert len(five.splitlines()) <= 5
    NotebookClient(notebook, timeout=120, resources={"metadata": {"path": str(tmp_path)}}).execute()
    shown = [output.get("data", {}) for cell in code for output in cell.outputs]
    assert sum("image/png" in data for data in shown) == 3
    said = "".join(output.text for cell in code for output in cell.outputs if output.output_type == "stream")
    assert "reached after" in said, said
    length, lidar, wheels = (
        float(re.search(pattern, said)[1])  # type: ignore[index]
        for pattern in (r"^([\d.]+) m,", r"LiDAR: ([\d.]+) mm", r"wheels and IMU: ([\d.]+) mm")
    )
    assert 4.0 < length < 9.0
    assert 0.0 < lidar < wheels
