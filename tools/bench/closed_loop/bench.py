"""The paper's closed-loop study: every method's routes driven with the true pose on four rescue scenes.

`python -m tools.bench closed_loop --out DIR --policy DIR` writes `routes.jsonl` and `trials.jsonl` (one line each as
they come; what
stands there is not computed again), then `tables.md` and pictures. `docs/measurements/evaluation.md` has the protocol
and the results.
"""

from __future__ import annotations

import argparse
import importlib
import json
from collections.abc import Iterable, Iterator
from dataclasses import asdict
from pathlib import Path
from typing import Any

from rich.progress import track

from hal.robots import describe
from hal.robots.go2w.locomotion.controllers import policy_of
from hal.robots.go2w.locomotion.torchfile import PolicyError
from tools.bench.closed_loop import lrc, protocol
from tools.bench.closed_loop.routes import Route, routes
from tools.bench.closed_loop.tables import markdown, report
from tools.bench.closed_loop.trial import drive
from tools.bench.report import Report
from tools.bench.spread import spread

Key = tuple[str, int, str, str]


def run(args: list[str]) -> Report:
    """Run this bench with the arguments of its command line; returns its rows. `why ...` and `film ...` look at a
    study's records."""
    if args[:1] in (["why"], ["film"]):
        return importlib.import_module(f"tools.bench.closed_loop.{args[0]}").run(args[1:])  # type: ignore[no-any-return]
    options = _options(args)
    options.out.mkdir(parents=True, exist_ok=True)
    wanted = protocol.trials(
        options.methods,
        options.controller,
        options.colliders,
        options.scenes,
        options.draws,
        options.queries,
    )
    found = _routes(options)
    if options.lrc or options.endurance:
        return _to_and_fro(options, wanted, found)
    file = options.out / "trials.jsonl"
    done = {r["key"]: r for r in read(file)}
    left = [t for t in wanted if t.key not in done]
    work = [(t, found[t.scene, t.query, _line_of(t.method), _planned_for(t)], options.policy) for t in left]
    for record in _written(
        file, spread(drive_any, work, options.workers, options.scheduler), len(work), "trials"
    ):
        done[record["key"]] = record
    records = [done[t.key] for t in wanted]
    (options.out / "tables.md").write_text(markdown(records))
    if records:
        from tools.bench.closed_loop import pictures  # matplotlib takes a second to load

        pictures.draw(options.out, records, list(found.values()))
    return report(records)


def _to_and_fro(options: argparse.Namespace, wanted: list[protocol.Trial], found: dict[Key, Route]) -> Report:
    """The same lines driven to and fro."""
    file = options.out / ("endurance.jsonl" if options.endurance else "lrc.jsonl")
    done = {r["key"]: r for r in read(file)}
    work = [
        (t, found[t.scene, t.query, t.method, _planned_for(t)], options.policy, options.endurance)
        for t in wanted
        if t.key not in done
    ]
    runs = spread(lrc.drive, work, options.workers, options.scheduler)
    for record in _written(file, runs, len(work), "runs"):
        done[record["key"]] = record
    return lrc.report([done[t.key] for t in wanted])


def _options(args: list[str]) -> argparse.Namespace:
    parser = argparse.ArgumentParser(prog="python -m tools.bench closed_loop", description=__doc__)
    add = parser.add_argument

    def names(known: tuple[str, ...], own: bool = False) -> Any:
        def read_names(text: str) -> list[str]:
            wrong = {name for name in text.split(",") if name not in known and not (own and ":" in name)}
            if wrong:
                raise argparse.ArgumentTypeError(f"no {', '.join(sorted(wrong))}: use {', '.join(known)}")
            return text.split(",")

        return read_names

    add("--out", type=Path, required=True, help="folder of records, tables and pictures")
    add("--scenes", type=names(protocol.SCENES), default=list(protocol.SCENES))
    add("--methods", type=names(protocol.METHODS, own=True), default=["native", "full"])
    add("--controller", type=names(describe().own), default=["policy"])
    add("--colliders", type=names(protocol.COLLIDERS), default=["all"])
    add(
        "--policy",
        default="",
        help="of the controllers that learnt: folder, file or name; else ours for hybrid, the fetched one for policy",
    )
    add("--draws", type=int, default=5, help="frictions and start offsets per query")
    add("--queries", type=int, default=protocol.QUERY_COUNT, help="start-goal pairs per scene, at most 40")
    add("--workers", type=int, default=1, help="processes on this machine; 0: this one")
    add("--scheduler", default="", help="address of a dask scheduler: spread the work there")
    add("--lrc", action="store_true", help="to and fro on each line for 5 minutes, at most 10 traverses")
    add("--endurance", action="store_true", help="to and fro on each line, 30 repetitions")
    options = parser.parse_args(args)
    if (options.lrc or options.endurance) and set(options.methods) & set(protocol.PERCEIVED):
        parser.error(f"{', '.join(protocol.PERCEIVED)} have no line to drive to and fro")
    try:
        for name in set(options.controller) - {"vmc"}:
            policy_of(name, options.policy)
    except PolicyError as error:
        parser.error(str(error))
    if "vendor" in options.colliders and set(options.methods) & set(protocol.PERCEIVED):
        parser.error(f"{', '.join(protocol.PERCEIVED)} have our colliders: use --colliders all")
    if not 1 <= options.queries <= protocol.MOST_QUERIES:
        parser.error(f"--queries must lie in 1..{protocol.MOST_QUERIES}")
    return options


def drive_any(trial: protocol.Trial, route: Route, policy: str) -> dict[str, Any]:
    """The record of a trial, with the true pose or with the stack's own."""
    if trial.method in protocol.PERCEIVED:
        from tools.bench.closed_loop import stack  # the whole stack takes a second to load

        return stack.drive(trial, route, policy)
    return drive(trial, route, policy)


def _line_of(method: str) -> str:
    """The method whose line a method is placed along."""
    return "ours" if method in protocol.PERCEIVED else method


def _planned_for(trial: protocol.Trial) -> str:
    return trial.controller if _line_of(trial.method) == "ours" else ""


def _routes(options: argparse.Namespace) -> dict[Key, Route]:
    """The routes of all methods: read, or planned and written."""
    file = options.out / "routes.jsonl"
    planned = list(dict.fromkeys(map(_line_of, options.methods)))
    known = {_key(r): r for r in read(file)}
    work = []
    for scene in options.scenes:
        for query in range(options.queries):
            controllers = [c for c in options.controller if (scene, query, "ours", c) not in known]
            methods = [
                m for m in planned if (controllers if m == "ours" else (scene, query, m, "") not in known)
            ]
            if methods:
                work.append((scene, query, methods, controllers))
    for record in _written(
        file, _planned(spread(plan_query, work, options.workers, options.scheduler)), None, "routes"
    ):
        known[_key(record)] = record
    return {key: Route(**record) for key, record in known.items()}


def plan_query(scene: str, query: int, methods: list[str], controllers: list[str]) -> dict[str, Any]:
    """Routes of a query as JSON."""
    return {"routes": [asdict(r) for r in routes(scene, query, methods, controllers)]}


def _planned(queries: Iterable[dict[str, Any]]) -> Iterator[dict[str, Any]]:
    for query in queries:
        yield from query["routes"]


def _key(record: dict[str, Any]) -> Key:
    return record["scene"], record["query"], record["method"], record["controller"]


def read(file: Path) -> list[dict[str, Any]]:
    """Records of a file; a line that was cut off when its writer died is left out."""
    if not file.exists():
        return []
    lines = file.read_text().splitlines(keepends=True)
    return [json.loads(line) for line in lines if line.endswith("\n") and line.strip()]


def _written(
    file: Path, records: Iterable[dict[str, Any]], total: int | None, what: str
) -> Iterator[dict[str, Any]]:
    """The records, each written as it comes, with a progress bar."""
    if file.exists():  # the rest of a line whose writer died
        text = file.read_text()
        if text and not text.endswith("\n"):
            file.write_text(text[: text.rfind("\n") + 1])
    with file.open("a") as out:
        for record in track(records, description=what, total=total):
            out.write(json.dumps(record) + "\n")
            out.flush()
            yield record
