"""`python -m tools.train run --out DIR [--minutes N] [--resume]` trains a policy; `python -m tools.train evaluate
POLICY` drives the envelope's
courses with it and, when it drives all of them, writes what it measured into the policy's header.
"""

from __future__ import annotations

import argparse
import os
import sys
from pathlib import Path

# Before JAX and numpy start their threads: the physics has the cores.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
os.environ.setdefault("XLA_FLAGS", "--xla_cpu_multi_thread_eigen=false")
# JAX takes three quarters of an accelerator's memory otherwise, and the physics needs some.
os.environ.setdefault("XLA_PYTHON_CLIENT_PREALLOCATE", "false")
ROBOT_COUNT = 4096
"""Robots on an accelerator."""


def main() -> None:
    """Run the command line."""
    parser = argparse.ArgumentParser(prog="python -m tools.train", description=__doc__)
    commands = parser.add_subparsers(dest="command", required=True)
    run = commands.add_parser("run", help="clone the model-based controller, then learn")
    run.add_argument("--out", type=Path, required=True, help="folder of checkpoint, policy and curves")
    run.add_argument("--minutes", type=float, default=90.0, help="of PPO in this call")
    run.add_argument("--resume", action="store_true", help="go on from the folder's checkpoint")
    run.add_argument("--seed", type=int, default=0)
    run.add_argument("--workers", type=int, default=2, help="processes that drive the teacher")
    run.add_argument(
        "--accelerator", action="store_true", help="physics by MuJoCo Warp, on a CUDA device if there is one"
    )
    run.add_argument("--robots", type=int, help="at once; default: as before, 512, or 4096 on an accelerator")
    evaluate = commands.add_parser("evaluate", help="the envelope bench")
    evaluate.add_argument("policy", type=Path)
    evaluate.add_argument("--controller", choices=("hybrid", "policy"), default="hybrid")
    options, rest = parser.parse_known_args()
    if options.command == "evaluate":
        from hal.robots.go2w.locomotion.weights import load_weights, save_weights
        from tools.bench.envelope import run as bench

        report = bench(["--controller", options.controller, "--policy", str(options.policy), *rest])
        print(report.to_text())
        if not rest and options.policy.suffix == ".npz":
            params, layers, facts = load_weights(options.policy)
            rows = {row.key: [round(row.value, 3), row.unit] for row in report.rows}
            save_weights(options.policy, params, layers, {**facts, "envelope": rows})
        return
    if rest:
        parser.error(f"unknown arguments: {' '.join(rest)}")
    try:
        import jax  # noqa: F401
        import optax  # noqa: F401
    except ImportError:
        sys.exit("training needs JAX: uv run --group train python -m tools.train run ...")
    from rich.console import Console

    from tools.train.physics import Robots

    physics = Robots
    if options.accelerator:
        try:
            from tools.train.warp import WarpRobots as physics
        except ImportError:
            sys.exit("--accelerator needs MuJoCo Warp: uv run --group train --group accelerator python ...")
    from tools.train.checkpoint import FILE, Checkpoint
    from tools.train.run import clone, train
    from tools.train.settings import Settings

    console = Console()
    there = (options.out / FILE).exists()
    if options.resume and not there:
        sys.exit(f"{options.out / FILE} does not exist: leave --resume out to begin a run")
    if there and not options.resume:
        sys.exit(f"{options.out / FILE} exists: give --resume to go on, or another --out")
    options.out.mkdir(parents=True, exist_ok=True)
    point = (
        Checkpoint.load(options.out)
        if options.resume
        else clone(Settings(seed=options.seed), options.workers, options.out, console)
    )
    if robots := options.robots or (ROBOT_COUNT if options.accelerator else None):
        ppo = point.settings.ppo.model_copy(update={"robots": robots})
        point.settings = point.settings.model_copy(update={"ppo": ppo})
    train(point, options.minutes, options.out, console, robots=physics)


if __name__ == "__main__":
    main()
