"""The paper's static study: all variants on the same graphs of four rescue scenes (its Table 1).

`python -m tools.bench static --out DIR [--seeds N] [--pairs N] [--json]` writes `static.json` (every instance),
`static.md` and pictures to DIR. Scenes, surveys and start-goal pairs come from `hal.scenes`; graph settings are the
dense
ones of the published scenes. Limits are the paper's reductions of full against native, in the same run, per graph.

Per route: planar length; the largest d_fb, a_lr, p_int of any pose along its edges and in its turns, the first ten
centimetres to the last; untrusted = mean unknown share of the edge poses, weighted by edge length. Every variant is
measured with the same yardstick, the paper's body model. The table is about the paper's cost: what a turn over an edge
costs beyond it (`planning.risk.turns`) is left out. Graphs of one query resemble each other: each query counts once, by
its mean,
and intervals come from resamples of whole queries within their scenes, as in the closed-loop study.
"""

from __future__ import annotations

import argparse
import json
from dataclasses import asdict
from pathlib import Path

from planning.search.plan import VARIANTS
from tools.bench.report import Report
from tools.bench.static import table
from tools.bench.static.study import EXPECTED, METRICS, MODES, changed, macro, study, values


def run(args: list[str]) -> Report:
    """Run this bench with the arguments of its command line; returns its rows."""
    parser = argparse.ArgumentParser(prog="tools.bench static")
    parser.add_argument("--out", type=Path, required=True, help="folder for the table and the pictures")
    parser.add_argument("--seeds", type=int, default=10, help="graphs per scene and mode")
    parser.add_argument("--pairs", type=int, default=5, help="start-goal pairs per graph, at most 40")
    options = parser.parse_args(args)
    options.out.mkdir(parents=True, exist_ok=True)
    instances, drawn, missing = study(options.seeds, options.pairs)
    report = Report("static")
    for graph in MODES:
        native = values(instances, graph, "native")
        if not native:
            continue
        base = macro(native)
        for variant in VARIANTS:
            mean = macro(values(instances, graph, variant))
            for k, (metric, unit) in enumerate(METRICS.items()):
                limit = (
                    base[k] * (1.0 + EXPECTED[metric]) if variant == "full" and metric in EXPECTED else None
                )
                report.add(f"{metric}.{variant}.{graph}", mean[k], unit, limit=limit, baseline=base[k])
            report.add(f"changed.{variant}.{graph}", changed(instances, graph, variant), "-")
        count = sum((i.graph, i.variant) == (graph, "native") for i in instances)
        report.add(f"instances.{graph}", count, "-")
    (options.out / "static.json").write_text(
        json.dumps({"instances": [asdict(i) for i in instances], "missing": missing}, indent=1)
    )
    (options.out / "static.md").write_text(table.markdown(instances, missing))
    from tools.bench.static import pictures  # with matplotlib, for which everybody else would wait

    pictures.draw(options.out, instances, drawn)
    return report
