"""Rescue lanes from seeds, driven by the whole stack in lockstep: goals reached, falls, refusals, detours, touched
walls.

One line per trial goes to `--out` (JSON); trials that stand in it are not driven again. docs/measurements/lanes.json
names the first unused seeds.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from hal.robots import DEFAULT, describe
from tools.bench.lanes.picture import draw
from tools.bench.lanes.table import table
from tools.bench.lanes.trial import Trial, drive
from tools.bench.records import Records, numbers
from tools.bench.report import Report
from tools.bench.spread import spread


def run(args: list[str]) -> Report:
    """Run this bench with the arguments of its command line; returns its rows."""
    parser = argparse.ArgumentParser(prog="python -m tools.bench lanes", description=__doc__)
    parser.add_argument("--seeds", default="0-39", help="such as 0-39 or 3,7,12")
    parser.add_argument("--levels", default="1-5")
    parser.add_argument(
        "--made-of", default="", help="elements instead of the seed's own, such as kerbs or kerbs,bars,rails"
    )
    parser.add_argument("--set", action="append", default=[], help="set one key of the stack: a.b=c")
    options = drives(parser, args, "prior")
    trials = [
        Trial(
            seed,
            level,
            controller,
            how,
            options.policy,
            tuple(options.set),
            str(options.logs or ""),
            made_of=made_of,
        )
        for seed in numbers(options.seeds)
        for made_of in options.made_of.split(",")
        for how in options.map.split(",")
        for controller in options.controller.split(",")
        for level in numbers(options.levels)
    ]
    return table(driven(trials, options.out, options.pictures, options.workers, options.scheduler))


def drives(parser: argparse.ArgumentParser, args: list[str], how: str) -> argparse.Namespace:
    """Add what benches of drives have in common and read their command line; `how`: the map unless told."""
    parser.add_argument(
        "--controller", default="hybrid", help="of the default robot or ROBOT/NAME, or several: vmc,hybrid"
    )
    parser.add_argument(
        "--policy",
        default="",
        help="of the controllers that learnt: folder, file or name; else ours for hybrid, the fetched one for policy",
    )
    parser.add_argument("--map", default=how, help="prior, seen or both: prior,seen")
    parser.add_argument(
        "--pictures", type=Path, help="folder for a picture of every trial not as it should be"
    )
    parser.add_argument("--logs", type=Path, help="folder for the log of every trial")
    spreads(parser)
    options = parser.parse_args(args)
    for driver in options.controller.split(","):
        robot, _, name = driver.rpartition("/")
        if name not in (own := describe(robot or DEFAULT).own):
            parser.error(f"--controller: {driver} is none of {', '.join(own)}")
    if unknown := set(options.map.split(",")) - {"prior", "seen"}:
        parser.error(f"--map: {', '.join(sorted(unknown))} is none of prior, seen")
    for folder in (options.pictures, options.logs):
        if folder:
            folder.mkdir(parents=True, exist_ok=True)
    return options


def spreads(parser: argparse.ArgumentParser) -> None:
    """Add where the drives run, and where their records go."""
    parser.add_argument("--out", type=Path, help="file of records: what stands in it is not driven again")
    parser.add_argument("--workers", type=int, default=1, help="processes on this machine; 0: this one")
    parser.add_argument(
        "--scheduler", default="", help="address of a dask scheduler: spread the trials there"
    )


def driven(
    trials: Sequence[Trial], out: Path | None, pictures: Path | None, workers: int, scheduler: str
) -> list[dict[str, Any]]:
    """Records of `trials`, those that stand in the file `out` and those that are driven now; see `spread`. `pictures`:
    a folder."""
    records, wanted = Records(out), {trial.key for trial in trials}
    done = {key: record for key, record in records.done.items() if key in wanted}
    left = [trial for trial in trials if trial.key not in done]
    for record in spread(drive, [(trial,) for trial in left], workers, scheduler):
        done[record["key"]] = record
        records.add(record)
        told = f"{record['outcome']} {record['reason']} {record['detail']}"
        print(
            f"{len(done)}/{len(trials)} {record['key']} {told} {record['time']:.1f} s",
            file=sys.stderr,
            flush=True,
        )
        if pictures and record["outcome"] != ("refused" if record["level"] == 5 else "reached"):
            draw(record, pictures / f"{record['key']}.png")
    return list(done.values())
