"""Every fault in two sizes and some seeds; with `--without MONITOR` to see that it is this monitor that catches it."""

from __future__ import annotations

import argparse
import sys
from contextlib import ExitStack
from importlib import import_module
from pathlib import Path
from pkgutil import iter_modules

from hal.safety.monitors import BY_NAME, taken_out
from tools.bench.faults.fault import Fault
from tools.bench.report import Report


def all_faults() -> dict[str, Fault]:
    """The faults of every module of this folder, by name."""
    faults: dict[str, Fault] = {}
    for module in iter_modules([str(Path(__file__).parent)]):
        listed = getattr(import_module(f"tools.bench.faults.{module.name}"), "FAULTS", ())
        faults |= {fault.name: fault for fault in listed}
    return faults


def run(args: list[str]) -> Report:
    """Run this bench with the arguments of its command line; returns its rows."""
    faults = all_faults()
    parser = argparse.ArgumentParser(prog="python -m tools.bench faults", description=__doc__)
    parser.add_argument("--only", nargs="*", choices=sorted(faults), default=sorted(faults))
    parser.add_argument("--without", nargs="*", choices=sorted(BY_NAME), default=[], metavar="MONITOR")
    parser.add_argument("--seeds", nargs="*", type=int, default=[0, 1, 2])
    parser.add_argument("--sizes", type=int, choices=(1, 2), default=2, help="how many of the two sizes")
    options = parser.parse_args(args)
    report = Report("faults")
    with ExitStack() as stack:
        stack.enter_context(taken_out(*options.without))
        for name in options.only:
            _row(report, faults[name], options.sizes, options.seeds)
    return report


def _row(report: Report, fault: Fault, sizes: int, seeds: list[int]) -> None:
    held, outcomes = 0, []
    for size in fault.sizes[:sizes]:
        for seed in seeds:
            outcome = fault.inject(size, seed)
            outcomes.append(outcome)
            missed = fault.missed(outcome)
            held += not missed
            if missed:
                print(f"{fault.name}, size {size:g}, seed {seed}: {missed}", file=sys.stderr)
    report.rate(f"{fault.name}.held", held, len(outcomes), limit=1.0)
    report.add(f"{fault.name}.moved_m", max(o.moved for o in outcomes), "m")
    if fault.rest is not None:
        report.add(f"{fault.name}.rest_s", max(o.rest for o in outcomes), "s", fault.rest)
