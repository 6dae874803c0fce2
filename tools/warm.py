"""Compile every kernel of the stack and leave it in numba's cache: one process per part, as many at once as there are
cores.

    python -m tools.warm

Without it each worker of pytest compiles for itself what another one is compiling at that moment.
"""

from __future__ import annotations

import os
import time
from concurrent.futures import ProcessPoolExecutor
from multiprocessing import get_context

from rbtrg_robot.process.kernels import KERNEL_FILES, Compiling

PARTS = ("planner", "robot", "elevation", "odometry", "native", "guard", "unitree")
"""The longest first."""


def warm(part: str) -> float:
    """Seconds it took. Raises what the part raises."""
    began = time.monotonic()
    if part == "unitree":
        from hal.unitree.config import UnitreeConfig
        from hal.unitree.telemetry import Telemetry

        Telemetry(None, UnitreeConfig()).warm_up()  # type: ignore[arg-type]
    elif part == "native":
        import numpy as np

        from mapping.grid import ElevationGrid
        from tools.baselines.native import NativeParams, native_graph

        flat = np.zeros((50, 50), np.float32)
        grid = ElevationGrid(flat, np.ones(flat.shape, bool), (0.0, 0.0), 0.05)
        native_graph(grid, (1.25, 1.25), NativeParams(), 0)
    else:
        from rbtrg_robot.config import load
        from rbtrg_robot.hosts.lockstep import build_stages
        from rbtrg_robot.hosts.robot import build
        from rbtrg_robot.stages.stage import warm as warm_stage

        config = load(None, [], scene="flat")
        stage = build(config) if part == "robot" else build_stages(config, [part])[part][0]
        warm_stage(stage)
        stage.close()
    return time.monotonic() - began


def main() -> None:
    """All parts. Ends with a message where `up` would tell a wrong number of kernels."""
    compiling = Compiling()
    with ProcessPoolExecutor(os.cpu_count(), get_context("spawn")) as pool:
        for part, seconds in zip(PARTS, pool.map(warm, PARTS), strict=True):
            print(f"{part}: {seconds:.0f} s")
    if compiling.cold and abs(compiling.done - KERNEL_FILES) > 0.1 * KERNEL_FILES:
        raise SystemExit(f"{compiling.done} kernels were compiled: say so in rbtrg_robot/process/kernels.py")


if __name__ == "__main__":
    main()
