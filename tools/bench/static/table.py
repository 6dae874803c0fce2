"""The static study's table as Markdown."""

from __future__ import annotations

from collections.abc import Sequence

from planning.search.plan import VARIANTS
from tools.bench.static.study import (
    EXPECTED,
    METRICS,
    MODES,
    PAPER_NATIVE,
    SCENES,
    Instance,
    averaged,
    changed,
    interval,
    macro,
    values,
)

HEAD = ("length [m]", "max d_fb [m]", "max a_lr [deg]", "max p_int [m]", "untrusted [%]")
COLUMN_SCALE = (1.0, 1.0, 1.0, 1.0, 100.0)


def markdown(instances: Sequence[Instance], missing: Sequence[str]) -> str:
    """Table 1 per graph, the change against native with its interval, the verdict, and what had no route."""
    lines = ["# Static study", ""]
    for graph in MODES:
        native = values(instances, graph, "native")
        if not native:
            lines += [f"## {graph} graph", "", "No instance had a route.", ""]
            continue
        counts = ", ".join(f"{s} {_count(instances, graph, s)}" for s in SCENES)
        lines += [
            f"## {graph} graph",
            "",
            f"Instances: {counts}. Means of the scenes' means, each of its queries' means over graphs.",
            "",
        ]
        lines += ["| variant | " + " | ".join(HEAD) + " | changed routes |", "|---" * 7 + "|"]
        for variant in VARIANTS:
            mean = macro(values(instances, graph, variant)) * COLUMN_SCALE
            share = "" if variant == "native" else f"{100 * changed(instances, graph, variant):.0f} %"
            lines.append(f"| {variant} | " + " | ".join(f"{v:.3f}" for v in mean) + f" | {share} |")
        lines += ["", _room(instances, graph)]
        lines += ["", "Change against native, paired, with 95 % interval over queries:", ""]
        lines += ["| variant | " + " | ".join(METRICS) + " |", "|---" * 6 + "|"]
        for variant in VARIANTS[1:]:
            mine = values(instances, graph, variant)
            change, (low, high) = macro(mine) / macro(native) - 1.0, interval(mine, native)
            cells = [
                f"{100 * c:+.1f} % ({100 * a:+.1f} .. {100 * b:+.1f})"
                for c, a, b in zip(change, low, high, strict=True)
            ]
            lines.append(f"| {variant} | " + " | ".join(cells) + " |")
        lines.append(
            "| paper, full | "
            + " | ".join(f"{100 * EXPECTED[m]:+.1f} %" if m in EXPECTED else "" for m in METRICS)
            + " |"
        )
        lines += ["", _verdict(instances, graph), "", _through(instances, graph), ""]
        lines += ["Full against native per scene:", ""]
        lines += ["| scene | " + " | ".join(METRICS) + " |", "|---" * 6 + "|"]
        full = values(instances, graph, "full")
        for scene, v in native.items():
            cells = [f"{100 * c:+.1f} %" for c in full[scene].mean(axis=0) / v.mean(axis=0) - 1.0]
            lines.append(f"| {scene} | " + " | ".join(cells) + " |")
        lines.append("")
    paper = ", ".join(f"{m} {v:g} {METRICS[m]}".replace(" -", "") for m, v in PAPER_NATIVE.items())
    lines += [f"The paper's native means on its own scenes, for orientation: {paper}.", ""]
    if missing:
        lines += [f"## Without a route: {len(missing)}", "", *(f"- {m}" for m in missing), ""]
    return "\n".join(lines)


def _count(instances: Sequence[Instance], graph: str, scene: str) -> str:
    mine = [i for i in instances if (i.graph, i.variant, i.scene) == (graph, "native", scene)]
    return f"{len(mine)} of {len({i.pair for i in mine})} queries"


CORE = ("d_fb", "a_lr", "p_int")


def _room(instances: Sequence[Instance], graph: str) -> str:
    """How far the core maxima could fall at most, whatever the planner: what the terrain leaves to choose."""
    at = [list(METRICS).index(m) for m in CORE]
    least = macro(averaged(instances, graph, "native", lambda i: i.least))
    base, full = (macro(values(instances, graph, v))[at] for v in ("native", "full"))
    words = []
    for k, metric in enumerate(CORE):
        room, got, want = 1.0 - least[k] / base[k], 1.0 - full[k] / base[k], -EXPECTED[metric]
        text = f"{metric} {least[k]:.3f} {METRICS[metric]}, {100 * room:.1f} % below native"
        if got < want:
            text += f" (full: {100 * got:.1f} %"
            text += f"; the paper's {100 * want:.1f} % are more than there is)" if room < want else ")"
        words.append(text)
    return (
        "The terrain sets a floor. Least maxima that any route on the same graph could have, each by a route "
        "of its own and "
        "turns left out: " + "; ".join(words) + "."
    )


THROUGH_HEIGHT = 0.5
"""Interference from which a route has a wall under the body [m]: the graph's height threshold."""


def _through(instances: Sequence[Instance], graph: str) -> str:
    """How many native routes cross or graze something as high as a wall, and the change without those."""
    mine = [i for i in instances if (i.graph, i.variant) == (graph, "native")]
    walls = {(i.scene, i.seed, i.pair) for i in mine if i.p_int > THROUGH_HEIGHT}
    text = (
        f"On {len(walls)} of {len(mine)} instances the native route has something over {THROUGH_HEIGHT} m high "
        "under the body"
    )
    others = [i for i in instances if (i.scene, i.seed, i.pair) not in walls]
    if not walls or len(walls) == len(mine):
        return text + "."
    why = "a wall it grazes in a turn"
    if graph == "native":
        why += ", or a thin one it drives through, for the disc test does not see it"
    n, f = (macro(values(others, graph, v)) for v in ("native", "full"))
    rest = ", ".join(f"{m} {100 * c:+.1f} %" for m, c in zip(METRICS, f / n - 1.0, strict=True))
    return (
        f"{text}: {why}. Such a route is shorter than any the robot can drive, and full adds the way around. "
        f"On the other instances full against native: {rest} (they are chosen by native's result: where the "
        "change comes "
        f"from, not how large it is)."
    )


def _verdict(instances: Sequence[Instance], graph: str) -> str:
    """Which of the paper's reductions are reached on this graph."""
    native, full = (macro(values(instances, graph, v)) for v in ("native", "full"))
    words = []
    for k, metric in enumerate(METRICS):
        if metric in EXPECTED:
            got = full[k] / native[k] - 1.0
            met = "reached" if got <= EXPECTED[metric] else "MISSED"
            words.append(f"{metric} {100 * got:+.1f} % for {100 * EXPECTED[metric]:+.1f} %: {met}")
    return "; ".join(words) + "."
