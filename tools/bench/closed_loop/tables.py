"""The study's tables and rows."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from typing import Any

import numpy as np

from tools.bench.closed_loop.protocol import SCENES, methods_in
from tools.bench.closed_loop.statistics import Difference, difference, end_to_end, interval
from tools.bench.report import Report, least_rate

Record = dict[str, Any]
PAPER = {
    "native": (0.515, 0.595),
    "full": (0.685, 0.761),
    "t_hybrid": (0.09, float("nan")),
    "art": (0.05, float("nan")),
}
"""End-to-end and conditional success that the paper reports."""
MEANS = {
    "rmse": ("m", 1.0, 3),
    "contact": ("%", 100.0, 1),
    "contact_housing": ("%", 100.0, 1),
    "contact_trunk": ("%", 100.0, 1),
    "contact_leg": ("%", 100.0, 1),
    "slip": ("-", 1.0, 2),
    "pitch95": ("deg", 1.0, 1),
    "roll95": ("deg", 1.0, 1),
}
"""Unit, scale and digits of the means over eligible trials."""
SETTINGS = ("controller", "colliders")


def report(records: Sequence[Record]) -> Report:
    """Rows `CONTROLLER.COLLIDERS.METHOD.SCENE.FIGURE`."""
    out = Report("closed_loop")
    for setting, group in _settings(records).items():
        for method in _methods(group):
            for scene in (*SCENES, "all"):
                mine = [r for r in group if r["method"] == method and scene in (r["scene"], "all")]
                if mine:
                    _rows(out, f"{setting}.{method}.{scene}", mine)
    simulated = sum(r.get("simulated", 0.0) for r in records)
    cpu = sum(r.get("cpu", 0.0) for r in records)
    out.add("simulated_per_cpu", simulated / cpu if cpu else float("nan"), "-")
    return out


def _rows(out: Report, key: str, mine: Sequence[Record]) -> None:
    eligible = [r for r in mine if r["eligible"]]
    hits = sum(r["success"] for r in mine)
    out.rate(f"{key}.coverage", sum(r["routed"] for r in mine), len(mine))
    out.rate(f"{key}.eligible", len(eligible), len(mine))
    out.rate(f"{key}.conditional", hits, len(eligible))
    out.rate(f"{key}.e2e", hits, len(mine))
    out.rate(f"{key}.strict", sum(r.get("strict", False) for r in mine), len(mine))
    out.rate(f"{key}.falls", sum(r.get("cause") in FALLS for r in mine), len(mine), at_least=False)
    for name, (unit, _, _) in MEANS.items():
        if eligible:
            out.add(f"{key}.{name}", _mean(eligible, name), unit.replace("%", "share"))


FALLS = ("fall", "off an edge")


def _mean(records: Sequence[Record], name: str) -> float:
    """NaN for what these trials do not have, such as the distance from a line where the stack makes new ones on its
    way."""
    return float(np.mean([_value(r, name) for r in records]))


def _value(record: Record, name: str) -> float:
    value = record[name]
    return float("nan") if value is None else float(value)


def markdown(records: Sequence[Record]) -> str:
    """All tables."""
    if not records:
        return "No trials.\n"
    lines: list[str] = []
    for setting, group in _settings(records).items():
        draws = 1 + max(r["draw"] for r in group)
        lines += [f"## {setting}: {len(group)} trials, {draws} draws", ""]
        lines += [*_success(group), *_scenes(group), *_differences(group), *_walls(group), *_quality(group)]
        lines += _causes(group)
    cpu = sum(r.get("cpu", 0.0) for r in records)
    simulated = sum(r.get("simulated", 0.0) for r in records)
    lines.append(
        f"{len(records)} trials, {simulated / 3600:.1f} h simulated in {cpu / 3600:.2f} h of processor time."
    )
    return "\n".join(lines) + "\n"


def _success(group: Sequence[Record]) -> list[str]:
    lines = [
        "| method | routed | eligible | conditional | end to end | 95 % of queries | strict | paper e2e (cond.) |",
        "|---|---|---|---|---|---|---|---|",
    ]
    for method in _methods(group):
        mine = [r for r in group if r["method"] == method]
        eligible = [r for r in mine if r["eligible"]]
        hits = sum(r["success"] for r in mine)
        low, high = interval(mine)
        paper = PAPER.get(method)
        told = (
            ""
            if paper is None
            else f"{_pc(paper[0])}" + ("" if np.isnan(paper[1]) else f" ({_pc(paper[1])})")
        )
        cells = [
            method,
            rate(sum(r["routed"] for r in mine), len(mine)),
            rate(len(eligible), len(mine)),
            rate(hits, len(eligible)),
            f"**{rate(hits, len(mine))}**",
            f"{_pc(low)} to {_pc(high)}",
            rate(sum(r.get("strict", False) for r in mine), len(mine)),
            told,
        ]
        lines.append(f"| {' | '.join(cells)} |")
    return [*lines, ""]


def _scenes(group: Sequence[Record]) -> list[str]:
    names = [s for s in SCENES if any(r["scene"] == s for r in group)]
    lines = [
        "End to end (conditional), per scene:",
        "",
        "| method | " + " | ".join(n.removeprefix("rescue_") for n in names) + " |",
        "|---" * (1 + len(names)) + "|",
    ]
    for method in _methods(group):
        cells = []
        for scene in names:
            mine = [r for r in group if (r["method"], r["scene"]) == (method, scene)]
            eligible = sum(r["eligible"] for r in mine)
            hits = sum(r["success"] for r in mine)
            cells.append(f"{_pc(hits / max(len(mine), 1))} ({_pc(hits / eligible) if eligible else '-'})")
        lines.append(f"| {method} | " + " | ".join(cells) + " |")
    return [*lines, ""]


def _differences(group: Sequence[Record]) -> list[str]:
    methods = [m for m in _methods(group) if m != "native"]
    if not methods or "native" not in _methods(group):
        return []
    lines = [
        "Against native on the same trials: difference, 95 % interval, lower bound at 80 %:",
        "",
        "| method | end to end [points] | conditional [points], jointly eligible | RMSE [mm], jointly eligible |",
        "|---|---|---|---|",
    ]
    for method in methods:
        a = difference(group, method, "native")
        b = difference(group, method, "native", counts=lambda r: r["eligible"])
        c = difference(group, method, "native", lambda r: _value(r, "rmse"), lambda r: r["eligible"])
        lines.append(f"| {method} | {_told(a, 100)} | {_told(b, 100)} | {_told(c, 1000)} |")
    return [*lines, ""]


def _told(d: Difference | None, scale: float) -> str:
    if d is None or np.isnan(d.value):
        return "-"
    v, low, high, least = (scale * x for x in (d.value, d.low, d.high, d.least))
    return f"{v:+.1f} [{low:+.1f}, {high:+.1f}], >= {least:+.1f}, {d.trials} trials"


def _walls(group: Sequence[Record]) -> list[str]:
    lines = [
        "Split by whether the route's centre line crosses a face above 0.3 m:",
        "",
        "| method | queries across | end to end there | end to end elsewhere |",
        "|---|---|---|---|",
    ]
    for method in _methods(group):
        mine = [r for r in group if r["method"] == method and r["routed"]]
        across = [r for r in mine if r["wall"]]
        rest = [r for r in mine if not r["wall"]]
        queries = len({(r["scene"], r["query"]) for r in across})
        cells = [rate(int(sum(map(end_to_end, part))), len(part)) for part in (across, rest)]
        lines.append(f"| {method} | {queries} | {cells[0]} | {cells[1]} |")
    return [*lines, ""]


def _quality(group: Sequence[Record]) -> list[str]:
    lines = [
        "Means over eligible trials (first 20 s, or until arrival); time of those that arrived:",
        "",
        "| method | "
        + " | ".join(f"{n} [{u}]" for n, (u, _, _) in MEANS.items())
        + " | time [s] | length [m] |",
        "|---" * (3 + len(MEANS)) + "|",
    ]
    for method in _methods(group):
        mine = [r for r in group if r["method"] == method and r["eligible"]]
        if not mine:
            continue
        means = {n: scale * _mean(mine, n) for n, (_, scale, _) in MEANS.items()}
        cells = ["-" if np.isnan(v) else f"{v:.{MEANS[n][2]}f}" for n, v in means.items()]
        times = [r["time"] for r in mine if r["success"]]
        cells += [
            f"{np.mean(times):.1f}" if times else "-",
            f"{np.mean([r['length'] for r in mine]):.2f}",
        ]
        lines.append(f"| {method} | " + " | ".join(cells) + " |")
    return [*lines, ""]


def _causes(group: Sequence[Record]) -> list[str]:
    found: dict[str, Counter[str]] = {}
    for r in group:
        if not r["success"]:
            found.setdefault(r["method"], Counter())[r.get("cause") or r["end"]] += 1
    names = sorted({c for counts in found.values() for c in counts})
    lines = [
        "Why trials failed:",
        "",
        "| method | " + " | ".join(names) + " |",
        "|---" * (1 + len(names)) + "|",
    ]
    for method in _methods(group):
        lines.append(
            f"| {method} | " + " | ".join(str(found.get(method, Counter())[c]) for c in names) + " |"
        )
    return [*lines, ""]


def rate(hits: int, trials: int) -> str:
    """Per cent, number of trials, lower bound at 80 % confidence if trials were independent."""
    if not trials:
        return "-"
    return f"{_pc(hits / trials)} ({hits}/{trials}, >= {_pc(least_rate(hits, trials))})"


def _pc(share: float) -> str:
    return f"{100.0 * share:.1f}"


def _settings(records: Sequence[Record]) -> dict[str, list[Record]]:
    out: dict[str, list[Record]] = {}
    for r in records:
        out.setdefault(".".join(r[s] for s in SETTINGS), []).append(r)
    return out


def _methods(records: Sequence[Record]) -> list[str]:
    return methods_in(records)
