"""Films of trials: `python -m tools.bench closed_loop film --out DIR KEY..` drives trials of a study again and writes
KEY.mp4."""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import matplotlib as mpl
import numpy as np

mpl.use("Agg")
from matplotlib import pyplot as plt

from hal.mujoco.sim import Simulation
from hal.mujoco.view.render import Film, View
from hal.types import NS
from tools.bench.closed_loop import protocol
from tools.bench.closed_loop.bench import read
from tools.bench.closed_loop.cases import Case, end_of
from tools.bench.closed_loop.pictures import colour_of
from tools.bench.closed_loop.routes import Route, scene_of
from tools.bench.closed_loop.trial import drive
from tools.bench.report import Report

SHOT_COUNT = 5
SMALL = View(width=300, height=240, fps=50, distance=2.2, follow=0.0)
"""Of the pictures of a strip: the camera looks at the robot."""
TIME_BEFORE, TIME_AFTER = 3.0, 2.0
"""A strip shows this time before and after a drive ended [s]."""


def shoot(
    record: dict[str, Any], route: Route, policy: str, view: View, times: Sequence[float] | None = None
) -> Film:
    """The trial driven again; its poses at `times` [s], or all."""
    trial = protocol.Trial(**{name: record[name] for name in protocol.Trial.__slots__})
    film = Film(scene_of(trial.scene).with_apron(protocol.APRON_WIDTH), view=view)
    left = list(times or [])

    def see(t: float, sim: Simulation) -> None:
        if times is not None:
            if not left or t < left[0]:
                return
            left.pop(0)
        w, x, y, z = sim.quaternion
        film.add(round(t * NS), sim.position, np.array([x, y, z, w]), sim.low_state().q)

    drive(trial, route, policy, see)
    return film


def strip(file: Path, case: Case, policy: str) -> None:
    """One draw in which one of two methods arrived: both routes from above, the drive that did not arrive around its
    end, the other on its way."""
    pair = case.parted[0]
    for candidate in case.parted:  # better one that drove
        if all(r["eligible"] for r in candidate):
            pair = candidate
            break
    figure, panels = plt.subplots(
        2, 1 + SHOT_COUNT, figsize=(13, 4.6), layout="constrained", width_ratios=[1.7, *[1.0] * SHOT_COUNT]
    )
    for k in (0, 1):
        record, route = pair[k], case.routes[k]
        _map(panels[k, 0], case, k, record)
        end = end_of(record, route)
        for panel in panels[k, 1:]:
            panel.set_axis_off()
        if end is None:
            panels[k, 1].text(0.0, 0.5, f"{record['end']}: {', '.join(record.get('why', []))}")
            continue
        last = record["trace"][-1][0]
        if record["success"]:
            times = np.linspace(0.0, last, SHOT_COUNT + 1)[1:]
        else:
            times = np.linspace(
                max(end.time - TIME_BEFORE, 0.2), min(end.time + TIME_AFTER, last), SHOT_COUNT
            )
        film = shoot(record, route, policy, SMALL, times.tolist())
        for panel, frame, t in zip(panels[k, 1:], film.frames(), times, strict=False):
            panel.imshow(frame)
            panel.set_title(f"{t:.1f} s", fontsize=8)
    figure.savefig(file, dpi=60)
    plt.close(figure)


def _map(panel: Any, case: Case, k: int, record: dict[str, Any]) -> None:
    scene = scene_of(case.scene)
    x0, y0, x1, y1 = scene.extent
    panel.imshow(scene.height, origin="lower", extent=(x0, x1, y0, y1), cmap="Greys")
    for j in (1 - k, k):
        line = np.array(case.routes[j].line)
        panel.plot(line[:, 0], line[:, 1], color=colour_of(case.routes[j].method), lw=2.0 if j == k else 0.8)
    if record.get("trace"):
        trace = np.array(record["trace"])
        panel.plot(trace[:, 1], trace[:, 2], "k-", lw=0.8)
        panel.plot(*trace[-1, 1:3], "k*" if record["success"] else "kx", ms=8)
    panel.set_title(f"{record['method']}: {record.get('cause') or record['end']}", fontsize=8)
    panel.set_axis_off()


def run(args: list[str]) -> Report:
    """`closed_loop film`."""
    parser = argparse.ArgumentParser(prog="python -m tools.bench closed_loop film", description=__doc__)
    parser.add_argument("--out", type=Path, required=True, help="folder of a study")
    parser.add_argument("--policy", default="", help="folder of the learnt policy")
    parser.add_argument("keys", nargs="+", help="such as rescue_steps.4.full.policy.all.0")
    options = parser.parse_args(args)
    routes = {
        (r["scene"], r["query"], r["method"], r["controller"]): Route(**r)
        for r in read(options.out / "routes.jsonl")
    }
    records = {r["key"]: r for r in read(options.out / "trials.jsonl")}
    report = Report("closed_loop")
    for key in options.keys:
        record = records.get(key)
        if record is None or not record["eligible"] or record["method"] in protocol.PERCEIVED:
            parser.error(f"{key}: no trial of this study that drove along a line")
        planned_for = record["controller"] if record["method"] == "ours" else ""
        route = routes[record["scene"], record["query"], record["method"], planned_for]
        film = shoot(record, route, options.policy, View(width=640, height=360))
        film.write(options.out / f"{key}.mp4")
        report.add(f"film.{key}.frames", len(film), "-")
    return report
