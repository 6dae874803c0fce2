"""Every fault in two sizes and some seeds; with `--without MONITOR` to see that it is this monitor that catches it.

One line per drive goes to `--out` (JSON); drives that stand in it are not driven again.
"""

from __future__ import annotations

import argparse
import sys
from contextlib import ExitStack
from dataclasses import asdict
from importlib import import_module
from pathlib import Path
from pkgutil import iter_modules

from hal.safety.monitors import BY_NAME, taken_out
from tools.bench.faults.fault import Fault, Outcome
from tools.bench.records import Record, Records, numbers
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
    parser.add_argument("--only", nargs="*", choices=sorted(faults), default=sorted(faults), metavar="FAULT")
    parser.add_argument("--without", nargs="*", choices=sorted(BY_NAME), default=[], metavar="MONITOR")
    parser.add_argument("--seeds", default="0-2", help="such as 0-19 or 3,7")
    parser.add_argument("--sizes", type=int, default=2, help="how many sizes of each fault at most")
    parser.add_argument("--out", type=Path, help="file of records: what stands in it is not driven again")
    options = parser.parse_args(args)
    report, records = Report("faults"), Records(options.out)
    with ExitStack() as stack:
        stack.enter_context(taken_out(*options.without))
        for name in options.only:
            _row(
                report, records, faults[name], options.sizes, numbers(options.seeds), "".join(options.without)
            )
    return report


def _row(report: Report, records: Records, fault: Fault, sizes: int, seeds: list[int], without: str) -> None:
    outcomes = []
    for size in fault.sizes[:sizes]:
        for seed in seeds:
            key = f"{fault.name}, size {size:g}, seed {seed}" + (f", without {without}" if without else "")
            outcomes.append(Outcome(**_plain(records.get(key, lambda: asdict(fault.inject(size, seed))))))  # noqa: B023 - asked at once
            if missed := fault.missed(outcomes[-1]):
                print(f"{key}: {missed}", file=sys.stderr, flush=True)
    held = sum(not fault.missed(outcome) for outcome in outcomes)
    report.rate(f"{fault.name}.held", held, len(outcomes), limit=1.0)
    report.add(f"{fault.name}.moved_m", max(o.moved for o in outcomes), "m")
    if fault.rest is not None:
        report.add(f"{fault.name}.rest_s", max(o.rest for o in outcomes), "s", fault.rest)


def _plain(record: Record) -> Record:
    return {name: value for name, value in record.items() if name != "key"}
