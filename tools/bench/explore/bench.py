"""Generated sites explored by the planner's order of places and by a plain nearest-frontier explorer on the same seeds.

`--how drawn`: the library alone, a robot without physics or noise, in seconds; `--how driven`: the whole stack in
lockstep, in minutes a site.
"""

from __future__ import annotations

import argparse
import json
import math
import sys
from pathlib import Path
from typing import Any

from tools.bench.explore.drawn import Walk
from tools.bench.explore.driven import drive
from tools.bench.explore.sites import SITES, site
from tools.bench.report import Report

ORDERS = ("ours", "nearest")
WAY_SHARE, SEEN_SHARE = 0.8, 0.97
"""Asked: the share of the nearest-first explorer's way, and of the reachable ground that is seen."""


def run(args: list[str]) -> Report:
    """Run this bench with the arguments of its command line; returns its rows."""
    parser = argparse.ArgumentParser(prog="python -m tools.bench explore", description=__doc__)
    parser.add_argument("--how", choices=("drawn", "driven"), default="drawn")
    parser.add_argument("--largest", type=float, default=60.0, help="sites of at most this side [m]")
    parser.add_argument("--kinds", default="rooms,yard,rubble,basement")
    parser.add_argument("--out", type=Path, help="file of records: what stands in it is not done again")
    parser.add_argument("--logs", type=Path, help="with `--how driven`: folder for the logs")
    options = parser.parse_args(args)
    if options.logs is not None:
        options.logs.mkdir(parents=True, exist_ok=True)
    chosen = [s for s in SITES if s[0] in options.kinds.split(",") and s[2] <= options.largest]
    if not chosen:
        parser.error("no site is of these kinds and so small")
    records = _read(options.out)
    for kind, seed, side in chosen:
        for order in ORDERS if options.how == "drawn" else ORDERS[:1]:
            key = f"{options.how}.{kind}.{seed}.{side:.0f}.{order}"
            if key in records:
                continue
            scene = site(kind, seed, side)
            if options.how == "drawn":
                record = Walk(scene, plain=order == "nearest").explore()
            else:
                record = drive(scene, logs=options.logs)
            records[key] = {"key": key, **record}
            print(f"{key} {record['share']:.3f} seen, {record['way']:.0f} m", file=sys.stderr, flush=True)
            if options.out:
                with options.out.open("a") as file:
                    file.write(json.dumps(records[key]) + "\n")
    wanted = [f"{options.how}.{kind}.{seed}.{side:.0f}" for kind, seed, side in chosen]
    return table([r for r in records.values() if r["key"].rpartition(".")[0] in wanted], options.how)


def table(records: list[dict[str, Any]], how: str) -> Report:
    """Rows `explore.HOW.*`: what was seen, came home, fell; of pairs on one site the ratio of ways to the same share
    and home."""
    report = Report("explore")
    by = {r["key"]: r for r in records}
    for order in ORDERS:
        mine = [r for r in records if r["key"].endswith(order)]
        if not mine:
            continue
        limit = order == "ours"
        report.rate(
            f"explore.{how}.{order}.seen_97",
            sum(r["share"] >= SEEN_SHARE for r in mine),
            len(mine),
            1.0 if limit else None,
        )
        report.add(f"explore.{how}.{order}.least_seen", min(r["share"] for r in mine), "share")
        report.rate(
            f"explore.{how}.{order}.home",
            sum(bool(r["home"]) for r in mine),
            len(mine),
            1.0 if limit else None,
        )
        if how == "driven":
            fell = sum(bool(r["fell"]) for r in mine)
            report.rate(f"explore.{how}.{order}.fell", fell, len(mine), 0.0, at_least=False)
        report.add(f"explore.{how}.{order}.way", sum(r["way"] for r in mine), "m")
    for name in ("at_0.5", "at_0.8", "at_0.95", "at_0.97", "way"):
        ratios = []
        for key, ours in by.items():
            other = by.get(f"{key.rpartition('.')[0]}.nearest")
            if key.endswith(".ours") and other and math.isfinite(ours[name] / other[name]):
                ratios.append((ours[name], other[name]))
        if ratios:
            ratio = sum(a for a, _ in ratios) / sum(b for _, b in ratios)
            limit_way = WAY_SHARE if name == "at_0.97" else None
            report.add(f"explore.{how}.ours_to_nearest.{name}", ratio, "ratio", limit_way)
    return report


def _read(file: Path | None) -> dict[str, dict[str, Any]]:
    if file is None or not file.exists():
        return {}
    found = [json.loads(line) for line in file.read_text().splitlines() if line]
    return {record["key"]: record for record in found}
