"""Why one method arrives where another does not: `python -m tools.bench closed_loop why --out DIR [--methods
native,full] [--strips N]`.

For each query with draws in which only one of two methods arrived: where their routes part, what each transition cost,
where the other robot ended.
Writes `why.md` and film strips to DIR.
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from hal.robots import describe
from planning.risk.body import BodyModel
from tools.bench.closed_loop import protocol
from tools.bench.closed_loop.bench import read
from tools.bench.closed_loop.cases import Case, cases, end_of
from tools.bench.closed_loop.routes import Route
from tools.bench.report import Report


def costs(transition: dict[str, float]) -> tuple[float, float]:
    """[m] under native and under full, without turns."""
    m, native = BodyModel(), 1.0 + BodyModel().weight_native * transition["risk"]
    body = m.weight_body * transition["body"] + m.weight_unknown * transition["unknown"]
    return transition["length"] * native, transition["length"] * (native + body)


def markdown(found: Sequence[Case], methods: tuple[str, str]) -> str:
    """The report."""
    lines = [
        f"# {methods[0]} against {methods[1]}: {len(found)} queries with another outcome",
        "",
        *_summary(found, methods),
    ]
    for case in found:
        arrived = [sum(pair[k]["success"] for pair in case.draws) for k in (0, 1)]
        n = len(case.draws)
        x, y = case.routes[0].vertices[max(case.shared - 1, 0)]
        lines += [
            f"## {case.scene} {case.query}: {methods[0]} {arrived[0]} of {n}, {methods[1]} {arrived[1]} of {n}",
            "",
            f"The routes share {case.shared} nodes and part at ({x:.2f}, {y:.2f}).",
            "",
        ]
        for k, method in enumerate(methods):
            lines += [*_route(method, case.routes[k]), *_ends(method, case, k), ""]
    return "\n".join(lines)


def _summary(found: Sequence[Case], methods: tuple[str, str]) -> list[str]:
    """Lost drives that only the other method won: is the worst of the route where it ended?"""
    lines = [
        "Drives that only the other method finished. B and cost are those of the transition where the drive "
        'ended; "worst": how many of these '
        "drives ended within one transition of the one with the largest B of the route.",
        "",
        "| lost by | drives | began | B there, median | B of the route, median | largest B of the other "
        "route, median | worst |",
        "|---|---|---|---|---|---|---|",
    ]
    for k, method in enumerate(methods):
        lost = [(c, pair[k]) for c in found for pair in c.parted if not pair[k]["success"]]
        rows = []
        for case, record in lost:
            end = end_of(record, case.routes[k])
            if end is None:
                continue
            body = [t["body"] for t in case.routes[k].transitions]
            other = max(t["body"] for t in case.routes[1 - k].transitions)
            rows.append(
                (
                    body[end.transition],
                    float(np.median(body)),
                    other,
                    abs(int(np.argmax(body)) - end.transition) <= 1,
                )
            )
        medians = [f"{np.median([r[i] for r in rows]):.2f}" if rows else "-" for i in range(3)]
        lines.append(
            f"| {method} | {len(lost)} | {len(rows)} | {' | '.join(medians)} | {sum(r[3] for r in rows)} |"
        )
    return [*lines, ""]


def _route(method: str, route: Route) -> list[str]:
    rows = [costs(t) for t in route.transitions]
    lines = [
        f"**{method}**: {route.length:.2f} m, cost {sum(r[0] for r in rows):.2f} under native, "
        f"{sum(r[1] for r in rows):.2f} under full"
        f"{', crosses a face above 0.3 m' if route.wall else ''}.",
        "",
        "| transition | to x, y [m] | length [m] | r | B | U | native [m] | full [m] |",
        "|---|---|---|---|---|---|---|---|",
    ]
    for k, (t, (native, full)) in enumerate(zip(route.transitions, rows, strict=True)):
        x, y = route.vertices[k + 1]
        lines.append(
            f"| {k} | {x:.2f}, {y:.2f} | {t['length']:.2f} | {t['risk']:.2f} | {t['body']:.2f} | {t['unknown']:.2f} "
            f"| {native:.2f} | {full:.2f} |"
        )
    return [*lines, ""]


def _ends(method: str, case: Case, k: int) -> list[str]:
    lines = []
    for pair in case.draws:
        record, end = pair[k], end_of(pair[k], case.routes[k])
        if record["success"]:
            lines.append(f"- draw {record['draw']}: arrived after {record['time']:.1f} s")
        elif end is None:
            lines.append(f"- draw {record['draw']}: {record['end']} ({', '.join(record.get('why', []))})")
        else:
            lines.append(
                f"- draw {record['draw']}: {record['cause']} after {end.time:.1f} s at ({end.place[0]:.2f}, "
                f"{end.place[1]:.2f}), transition {end.transition}; "
                f"pitch up to {record['pitch95']:.0f} deg, trunk or legs touch "
                f"{100 * (record['contact_trunk'] + record['contact_leg']):.0f} % of the time"
            )
    return lines


def run(args: list[str]) -> Report:
    """`closed_loop why`."""
    parser = argparse.ArgumentParser(prog="python -m tools.bench closed_loop why", description=__doc__)
    add = parser.add_argument
    add("--out", type=Path, required=True, help="folder of a study")
    add("--methods", default="native,full", help="two that share a graph")
    add("--controller", choices=describe().own, default="policy")
    add("--colliders", choices=protocol.COLLIDERS, default="all")
    add("--policy", default="", help="folder of the learnt policy, for the strips")
    add("--strips", type=int, default=0, help="how many film strips at most: each drives two trials again")
    options = parser.parse_args(args)
    methods = tuple(options.methods.split(","))
    if len(methods) != 2 or not set(methods) <= set(protocol.SHARED):
        parser.error(f"--methods: two of {', '.join(protocol.SHARED)}")
    routes = [Route(**r) for r in read(options.out / "routes.jsonl")]
    found = cases(
        read(options.out / "trials.jsonl"), routes, methods, (options.controller, options.colliders)
    )
    (options.out / "why.md").write_text(markdown(found, methods))
    if options.strips:
        from tools.bench.closed_loop import film

        for case in found[: options.strips]:
            film.strip(options.out / f"why_{case.scene}_{case.query}.png", case, options.policy)
    report = Report("closed_loop")
    report.add("why.queries", len(found), "-")
    for k, method in enumerate(methods):
        report.add(
            f"why.lost_by.{method}", sum(not pair[k]["success"] for c in found for pair in c.parted), "-"
        )
    return report
