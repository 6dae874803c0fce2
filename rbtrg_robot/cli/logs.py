"""`replay`, `log`."""

from __future__ import annotations

import json
import math
import signal
import sys
import time
from pathlib import Path
from typing import Annotated, Any

import typer

from rbtrg_robot.scope import NAMED, ROBOT
from rbtrg_robot.terminal import overwrite, say, say_json

Robot = Annotated[str, typer.Option("--robot", envvar=NAMED, help="Name of the robot.")]
LogFile = Annotated[Path, typer.Argument(help="A log, or the folder of a run.")]
Json = Annotated[bool, typer.Option("--json", help="Machine-readable.")]

log_app = typer.Typer(help="Look at, check and repair logs.", no_args_is_help=True)


def register(app: typer.Typer) -> None:
    """Add the commands."""
    app.add_typer(log_app, name="log")
    app.command()(replay)


def replay(
    file: LogFile,
    rate: Annotated[float, typer.Option(help="Speed.")] = 1.0,
    start_offset: Annotated[float, typer.Option(help="Skip this much of the log [s].")] = 0.0,
    duration: Annotated[float, typer.Option(help="Play this much [s]; default all.")] = math.inf,
    loop: Annotated[bool, typer.Option("--loop", help="Again and again.")] = False,
    topics: Annotated[
        list[str] | None, typer.Option(metavar="GLOB", help="Only topics that fit it; may be repeated.")
    ] = None,
    paused: Annotated[bool, typer.Option("--paused", help="Wait for the space bar.")] = False,
    rerun: Annotated[
        str | None, typer.Option(metavar="A,B,C", help="Instead: run these stages offline.")
    ] = None,
    out: Annotated[Path | None, typer.Option(help="Where --rerun writes.")] = None,
    config: Annotated[
        Path | None, typer.Option(help="For --rerun: YAML over the log's configuration.")
    ] = None,
    set_: Annotated[
        list[str] | None, typer.Option("--set", metavar="A.B=C", help="For --rerun: one key over it.")
    ] = None,
    robot: Robot = ROBOT,
    port: Annotated[int, typer.Option(help="TCP port of the router when no stack is up.")] = 7447,
) -> None:
    """Play a log on the bus, or run stages on it again. Keys: space: pause, right: next, up/down: rate, q: quit."""
    from rbtrg_robot.config import ConfigError

    if rerun is not None:
        names = [name for name in rerun.split(",") if name]
        _rerun(file, names, out, config, set_ or [], start_offset, duration)
        return
    if not (rate > 0 and math.isfinite(rate)):
        raise ConfigError(f"--rate must be positive, got {rate}")
    from rbtrg_robot.log.read import log_files
    from rbtrg_robot.log.replay import Controls, Report, alone, keyboard, play

    log_files(file)
    stopped: list[int] = []
    for sign in (signal.SIGINT, signal.SIGTERM):
        signal.signal(sign, lambda number, _frame: stopped.append(number))
    controls = Controls(rate=rate, paused=paused)
    total = Report()
    with _replay_bus(robot, port) as bus, keyboard() as key:
        check = alone(bus)
        while True:
            report = play(
                bus,
                file,
                controls=controls,
                check=check,
                start_offset=start_offset,
                duration=duration,
                patterns=topics or ["*"],
                key=key,
                progress=_progress,
                stopping=lambda: bool(stopped),
            )
            total.messages += report.messages
            total.late += report.late
            total.worst = max(total.worst, report.worst)
            total.seconds += report.seconds
            if not loop or stopped or controls.quit:
                break
    for name, count in sorted(report.skipped.items()):
        say(f"not replayed: {count} x {name}")
    for at, gap in report.jumps:
        say(f"the log jumps by {gap:.1f} s after {at:.1f} s: not waited for")
    say(
        f"replayed {total.messages} messages, {total.seconds - start_offset:.1f} s of log, "
        f"{total.late} late, worst {1000 * total.worst:.0f} ms"
    )
    if not total.messages and not stopped and not controls.quit:
        raise ConfigError(
            f"nothing of {file} was played: it holds no topic of ours in that part; `rbtrg-robot import` "
            "makes a run of a foreign bag"
        )


def _progress(seconds: float, controls: Any) -> None:
    if sys.stderr.isatty():
        overwrite(f"{seconds:8.1f} s  x{controls.rate:.2f}", error=True)


def _replay_bus(robot: str, port: int) -> Any:
    """The running stack's bus when it has no robot of its own, else a router of our own."""
    from rbtrg_robot.config import ConfigError
    from rbtrg_robot.process.runfiles import NotRunning, read_state
    from rbtrg_robot.scope import Scope
    from rbtrg_robot.wire.bus import Bus

    try:
        state = read_state(robot)
    except NotRunning:
        return Bus(f"tcp/127.0.0.1:{port}", "replay", Scope.of(0, robot), router=True)
    if "robot" in state["processes"]:  # it may be down this moment, and come back
        what = "real robot" if state["backend"] != "sim" else "simulated robot"
        raise ConfigError(
            f"a {what} is live on this bus (pid {state['pid']}); "
            "replay beside it is refused: `rbtrg-robot down`, or bring the stack up with --without robot"
        )
    return Bus(state["endpoint"], "replay", Scope.of(int(state["domain"]), robot))


def _rerun(
    file: Path,
    names: list[str],
    out: Path | None,
    config: Path | None,
    sets: list[str],
    start_offset: float,
    duration: float,
) -> None:
    from rbtrg_robot import topics as t
    from rbtrg_robot.config import ConfigError

    if out is None:
        raise ConfigError("--rerun needs --out NEW.mcap")
    if out.exists():
        raise ConfigError(f"{out} exists; name another file with --out")
    from rbtrg_robot.hosts.offline import rerun as run_again
    from rbtrg_robot.log.summary import overview

    held = overview(file).seconds
    if start_offset >= held > 0.0:
        raise ConfigError(f"--start-offset {start_offset:g} is behind the end: {file} is {held:.1f} s long")
    total = min(held - start_offset, duration)
    began = time.monotonic()
    done = 0.0
    with _bar() as bar:
        task = bar.add_task("rerun", total=total)

        def progress(seconds: float) -> None:
            nonlocal done
            done = seconds
            bar.update(task, completed=seconds)

        counts = run_again(
            *(file, names, out),
            file=config,
            sets=sets,
            start_offset=start_offset,
            duration=duration,
            progress=progress,
            say=say,
        )
    wall = time.monotonic() - began
    for name, count in sorted(counts.items()):
        say(f"{name:28s} {count:8d}")
    say(f"{done:.1f} s of log in {wall:.1f} s ({done / wall:.1f} x real time) -> {out}")
    for name, topic in (("odometry", t.ODOM), ("elevation", t.MAP_WINDOW)):
        if name in names and not counts.get(topic.name):
            later = "; it begins anew there, at rest: try an offset at which the robot stands" * bool(
                start_offset
            )
            raise ConfigError(
                f"nothing came out: {name} published no {topic.name} in {done:.1f} s of log{later}"
            )


@log_app.command("info")
def log_info(file: LogFile, as_json: Json = False) -> None:
    """Counts, rates, metadata. From the summaries of the files; gaps and losses: `log check`."""
    from rbtrg_robot.log.summary import overview

    summary = overview(file)
    if as_json:
        say_json(_overview(summary))
        return
    say(", ".join(summary.files))
    for key, value in summary.metadata.items():
        say(f"  {key}: {value}")
    say(f"{summary.seconds:.1f} s, {summary.size / 1e6:.1f} MB")
    say(f"{'topic':28s} {'type':38s} {'count':>8s} {'Hz':>8s}")
    for name, s in sorted(summary.topics.items()):
        foreign = (
            ""
            if s.encoding == "cdr"
            else f"  encoding {s.encoding or 'not told'}: not read here, handed on as it is"
        )
        say(f"{name:28s} {s.type or '-':38s} {s.count:8d} {s.rate:8.1f}{foreign}")
    for line in summary.damage:
        say(f"damage: {line}")
    for name in summary.unfinished:
        say(f"{name} is being written")


@log_app.command("check")
def log_check(file: LogFile, as_json: Json = False) -> None:
    """Say what is wrong with a log; exit 1 if anything is."""
    from rbtrg_robot.log.stats import summarize

    summary = summarize(file)
    problems = summary.problems()
    if as_json:
        say_json(_summary(summary) | {"problems": problems})
    else:
        for problem in problems or ["no problems found"]:
            say(problem)
    if problems:
        raise typer.Exit(1)


@log_app.command("recover")
def log_recover(
    file: LogFile,
    out: Annotated[Path | None, typer.Option(help="Default: FILE.recovered.mcap.")] = None,
    as_json: Json = False,
) -> None:
    """Write an indexed file from one whose recorder was killed."""
    from rbtrg_robot.log.write import recover

    target = out or file.with_name(f"{file.stem}.recovered.mcap")
    count, damage = recover(file, target)
    if as_json:
        say(json.dumps({"messages": count, "damage": damage, "out": str(target)}))
        return
    say(f"{count} messages -> {target}" + (f" (the file was damaged {damage})" if damage else ""))


@log_app.command("film")
def log_film(
    file: LogFile,
    out: Annotated[Path, typer.Argument(help="FILE.mp4, FILE.png (the end), or a folder for frames.")],
    speed: Annotated[float, typer.Option(min=0.1, help="Times as fast as it was.")] = 1.0,
    distance: Annotated[float, typer.Option(min=0.5, help="Camera from the robot [m].")] = 2.8,
) -> None:
    """Draw a simulated run from outside."""
    draw(file, out, speed, distance)


@log_app.command("photos")
def log_photos(
    file: LogFile,
    out: Annotated[
        Path | None, typer.Option(help="Folder for them; default: `photos` beside the log.")
    ] = None,
) -> None:
    """Write the photos of a run as JPEG files.

    Their names are the times of exposure [ns].
    """
    from rbtrg_robot.log.photos import save
    from rbtrg_robot.log.read import LogError

    folder = out or (file if file.is_dir() else file.parent) / "photos"
    try:
        written = save(file, folder)
    except OSError as error:
        raise LogError(f"cannot write into {folder}: {error.strerror}; --out names another folder") from error
    say(
        f"{len(written)} photos -> {folder}"
        if written
        else "no photo was taken: a mission step `photo` takes one"
    )


@log_app.command("list")
def log_list(
    base: Annotated[Path, typer.Argument(help="Folder of the runs.")] = Path("logs"), as_json: Json = False
) -> None:
    """The runs on the disk: size, and which are kept."""
    from rbtrg_robot.log.keep import GIGABYTE, runs

    found = runs(base)
    if as_json:
        say_json(
            [
                {"folder": str(run.folder), "bytes": run.size, "kept": run.kept, "being_written": run.active}
                for run in found
            ]
        )
        return
    for run in found:
        words = "kept" if run.kept else "being written" if run.active else ""
        say(f"{run.folder.name:48s} {run.size / 1e6:9.1f} MB  {words}".rstrip())
    say(f"{len(found)} runs, {sum(run.size for run in found) / GIGABYTE:.2f} GB")


@log_app.command("keep")
def log_keep(
    run: Annotated[Path, typer.Argument(help="Folder of a run.")],
    off: Annotated[bool, typer.Option("--off", help="No longer.")] = False,
) -> None:
    """Keep a run. The quota (`recorder.keep_gb`) never removes it."""
    from rbtrg_robot.log.keep import mark

    mark(run, keep=not off)
    say(f"{run} {'may go when the quota is full' if off else 'stays'}")


@log_app.command("picture")
def log_picture(file: LogFile, out: Annotated[Path, typer.Argument(help="FILE.png.")]) -> None:
    """Draw a run from above. The map at its end (not seen: dark; assumed, nobody saw it: orange), the last path, the
    way that was driven."""
    from rbtrg_robot.log.picture import picture

    say(f"{picture(file, out):.1f} m driven -> {out}")


@log_app.command("trajectory")
def log_trajectory(
    run: Annotated[Path, typer.Argument(help="A log, the folder of a run, or a TUM or KITTI file.")],
    out: Annotated[Path | None, typer.Option(help="FILE.tum or FILE.kitti to write.")] = None,
    against: Annotated[
        Path | None, typer.Option(help="Another run or file that is right: ATE and RPE against it.")
    ] = None,
    topic: Annotated[str, typer.Option(help="Where the poses are.")] = "/odom",
    against_topic: Annotated[str, typer.Option(help="The same of --against.")] = "/odom",
    format_: Annotated[str, typer.Option("--format", help="tum or kitti; default by the name.")] = "",
    distance: Annotated[float, typer.Option(help="Of RPE by distance [m].")] = 1.0,
    seconds: Annotated[float, typer.Option(help="Of RPE by time [s].")] = 1.0,
    as_json: Json = False,
) -> None:
    """The way of a run as a file, or how far it is from another. TUM or KITTI; ATE and RPE as evo counts them."""
    import dataclasses

    from rbtrg_robot.config import ConfigError
    from rbtrg_robot.log import trajectory as way

    if out is None and against is None:
        raise ConfigError("say --out FILE.tum, or --against RUN or FILE")
    if not (distance > 0 and seconds > 0):
        raise ConfigError("--distance and --seconds must be positive")

    def poses(path: Path, name: str) -> way.Trajectory:
        text = path.suffix.lower() in way.FORMATS and path.is_file()
        return way.read(path) if text else way.of_run(path, name)

    own = poses(run, topic)
    if out is not None:
        way.write(own, out, format_)
        if as_json and against is None:
            say_json({"poses": len(own.stamps), "length": own.length, "out": str(out)})
        else:
            say(f"{len(own.stamps)} poses, {own.length:.2f} m -> {out}", error=as_json)
    if against is None:
        return
    found = way.compare(own, poses(against, against_topic), distance, seconds)
    if as_json:
        say_json(dataclasses.asdict(found))
        return
    say(f"{found.pairs} poses in common, {found.length:.2f} m")
    say(f"ATE {found.ate:.6f} m (aligned)")
    for over, metres, degrees in (
        (f"{distance:g} m", found.rpe_distance, found.rpe_distance_deg),
        (f"{seconds:g} s ({found.frames} poses)", found.rpe_time, found.rpe_time_deg),
    ):
        short = math.isnan(metres)
        say(f"RPE over {over}: {'the run is shorter' if short else f'{metres:.6f} m, {degrees:.6f} deg'}")


def draw(log: Path, out: Path, speed: float = 1.0, distance: float = 2.8) -> None:
    """The film of a log, with a bar."""
    from hal.mujoco.view.render import View
    from rbtrg_robot.log.film import film

    with _bar() as bar:
        task = bar.add_task("film", total=None)
        poses = film(
            log,
            out,
            lambda done, total: bar.update(task, completed=done, total=total),
            View(speed=speed, distance=distance),
        )
    say(f"{poses} poses -> {out}")


def _bar() -> Any:
    """A progress bar on a terminal, below the words that are said meanwhile; none in a file."""
    from rich.progress import Progress

    return Progress(disable=not sys.stdout.isatty())


def _overview(found: Any) -> dict[str, Any]:
    return {
        "files": found.files,
        "metadata": found.metadata,
        "wall_seconds": found.seconds,
        "bytes": found.size,
        "damage": found.damage,
        "being_written": found.unfinished,
        "topics": {
            name: {"type": s.type, "encoding": s.encoding, "count": s.count, "rate": s.rate}
            for name, s in sorted(found.topics.items())
        },
    }


def _summary(summary: Any) -> dict[str, Any]:
    return {
        "files": summary.files,
        "metadata": summary.metadata,
        "wall_seconds": summary.wall_seconds,
        "damage": summary.damage,
        "being_written": summary.unfinished,
        "topics": {
            name: {
                "type": s.type,
                "count": s.count,
                "rate": s.rate,
                "longest_gap": s.longest_gap,
                "bytes": s.bytes,
                "missing": s.missing,
                "backwards": s.backwards,
            }
            for name, s in sorted(summary.topics.items())
        },
    }
