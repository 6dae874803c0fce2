"""`goal`, `cancel`, `stop`, `resume`, `posture`."""

from __future__ import annotations

import contextlib
import math
import uuid
from collections.abc import Callable
from typing import Annotated, Any, Literal, NoReturn

import typer

from rbtrg_robot.scope import NAMED, ROBOT
from rbtrg_robot.terminal import plain, say

Robot = Annotated[str, typer.Option("--robot", envvar=NAMED, help="Name of the robot.")]
REACHED, REJECTED, ABORTED, CANCELLED, TIMED_OUT = 0, 2, 3, 4, 5
READY_LIMIT, READY_PERIOD = 600.0, 1.0
"""A goal waits so long for a stack that starts [s], and looks so often: kernels compile for minutes."""
EXIT = {
    "reached": REACHED,
    "rejected": REJECTED,
    "aborted": ABORTED,
    "cancelled": CANCELLED,
    "preempted": CANCELLED,
}


def register(app: typer.Typer) -> None:
    """Add the commands."""
    app.command(context_settings={"ignore_unknown_options": True})(goal)
    app.command()(cancel)
    app.command()(stop)
    app.command()(resume)
    app.command()(posture)


def goal(
    target: Annotated[
        list[str] | None,
        typer.Argument(metavar="X Y | NAME", help="Metres in frame map, or one of the scene's goals."),
    ] = None,
    again: Annotated[
        bool, typer.Option("--again", help="The goal that was not reached once more, such as after a fall.")
    ] = False,
    yaw: Annotated[float | None, typer.Option(help="Heading at the goal [deg].")] = None,
    wait: Annotated[bool, typer.Option("--wait", help="Wait for the end.")] = False,
    accept: Annotated[
        bool, typer.Option("--accept", help="Drive it although it is likely to fail (planner.accept_risk).")
    ] = False,
    timeout: Annotated[float, typer.Option(help="Give up after this many seconds; 0 = never.")] = 0.0,
    back: Annotated[
        bool, typer.Option("--return/--no-return", help="Come home while the battery lasts for it.")
    ] = True,
    robot: Robot = ROBOT,
) -> None:
    """Send the robot to a place. Exit status: 0 reached, 2 rejected, 3 aborted, 4 cancelled or preempted, 5 timed
    out."""
    import time

    from rbtrg_robot.cli.link import connect, scene
    from rbtrg_robot.config import ConfigError
    from rbtrg_robot.orders.who import me
    from rbtrg_robot.stages.navigation.goal import goal_request

    if again and target:
        raise ConfigError("--again takes no target: it is that of the last goal")
    x, y, goal_yaw, name = (0.0, 0.0, None, "") if again else _target(target or [], lambda: scene(robot))
    with connect(robot) as bus:
        if again:
            x, y, goal_yaw = _last(bus)
        if yaw is not None:
            goal_yaw = math.radians(yaw)
        if not all(math.isfinite(v) for v in (x, y, goal_yaw or 0.0, timeout)):
            say("rbtrg-robot: goal rejected: coordinates must be finite numbers", error=True)
            raise typer.Exit(REJECTED)
        request = goal_request(
            time.time_ns(),
            uuid.uuid4().hex[:12],
            x,
            y,
            goal_yaw,
            name=name,
            timeout=timeout,
            owner=me(),
            accept_risk=accept,
            no_return=not back,
        )
        code = send(bus, request, wait=wait)
    raise typer.Exit(code)


def send(bus: Any, request: Any, *, wait: bool) -> int:
    """Send a goal and watch it, to its end with `wait`; Ctrl-C cancels it. Returns the exit status."""
    from rbtrg_robot.orders.goal import CancelGoal
    from rbtrg_robot.orders.order import follow

    if starting := _starting(bus):
        say(
            f"rbtrg-robot: not ready after {READY_LIMIT:.0f} s: {starting}; see `rbtrg-robot status`",
            error=True,
        )
        return ABORTED
    try:
        return _follow(bus, request, wait=wait)
    except KeyboardInterrupt:
        say("cancelling the goal", error=True)
        say(follow(bus, CancelGoal(request.id)).words)
        return CANCELLED


def _starting(bus: Any) -> str:
    """Waits while a process starts for the first time, and tells so. What it still waits for at the end; empty where
    all run, or where the supervisor does not answer: the navigator may."""
    import time

    end, told = time.monotonic() + READY_LIMIT, ""
    while why := _lacks(bus.ask("status")):
        if time.monotonic() > end:
            return why
        if why != told:
            told = why
            say(f"not ready yet, waiting up to {READY_LIMIT:.0f} s: {why}", error=True)
        time.sleep(READY_PERIOD)
    return ""


def _lacks(answer: bytes | None) -> str:
    """What a stack that starts waits for, from what came as its status; empty where it has started, or where that is
    no status: anybody may answer."""
    import json

    try:
        status = json.loads(answer or b"")
        starts = any(row["state"].startswith("starting") for row in status["processes"])
        return "" if status["ready"] or not starts else status["compiling"] or status["lacks"] or "processes"
    except (ValueError, LookupError, TypeError, AttributeError):
        return ""


def _target(
    words: list[str], find_scene: Callable[[], tuple[str, dict[str, Any]]]
) -> tuple[float, float, float | None, str]:
    from rbtrg_robot.config import ConfigError

    wrong = f"a goal is X Y in metres or a NAME, got {' '.join(words)!r}"
    numbers = []
    with contextlib.suppress(ValueError):
        numbers = [float(word) for word in words]
    if len(numbers) == 2:
        return numbers[0], numbers[1], None, ""
    if len(words) != 1 or numbers:
        raise ConfigError(wrong)
    scene, options = find_scene()
    if not scene:
        raise ConfigError(f"{wrong}; names exist in scenes simulated on this computer only")
    from hal.scenes import load_scene

    goals = load_scene(scene, **options).goals
    if words[0] not in goals:
        raise ConfigError(f"{wrong}; the names of scene {scene} are {', '.join(goals)}")
    x, y, yaw = goals[words[0]]
    return x, y, yaw, words[0]


def _last(bus: Any) -> tuple[float, float, float | None]:
    """Place [m] and heading [rad] of the newest goal, which ended somewhere else."""
    from rbtrg_robot.orders.goal import LastGoal
    from rbtrg_robot.orders.order import follow

    order = LastGoal()
    end = follow(bus, order)
    if order.status is None:
        _fail(end.words)
    return order.status.x, order.status.y, order.status.yaw if order.status.has_yaw else None


def _follow(bus: Any, request: Any, *, wait: bool) -> int:
    """Send until answered, then watch. Returns the exit status."""
    from rich.console import Console
    from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn

    from rbtrg_robot.cli.link import see_also
    from rbtrg_robot.orders.goal import SendGoal
    from rbtrg_robot.orders.mission import Present
    from rbtrg_robot.orders.order import follow

    console = Console(stderr=True)
    columns = (
        TextColumn("{task.description}", markup=False),
        BarColumn(),
        TextColumn("{task.fields[left]}"),
        TimeElapsedColumn(),
    )
    order = SendGoal(request, wait=wait)
    farthest, present = 0.0, Present(bus)
    with Progress(
        *columns, console=console, transient=True, disable=not (wait and console.is_terminal)
    ) as bar:
        task = bar.add_task("goal", total=1.0, left="")

        def show(_: Any) -> None:
            nonlocal farthest
            present()
            if (status := order.status) is not None:
                farthest = max(farthest, status.distance_left)
                done = 1.0 - status.distance_left / farthest if farthest else 0.0
                left = f"{status.distance_left:.1f} m"
                bar.update(task, description=plain(status.state), completed=done, left=left)

        end = follow(bus, order, show)
    if not end.state:
        say(f"rbtrg-robot: {end.words}; {see_also()}", error=True)
        return ABORTED
    code = TIMED_OUT if end.reason == "timeout" else EXIT.get(end.state, REACHED)
    say(end.words, error=code != REACHED)
    return code


def cancel(robot: Robot = ROBOT) -> None:
    """Cancel the present goal, whoever sent it; the robot stops."""
    from rbtrg_robot.cli.link import connect
    from rbtrg_robot.orders.goal import CancelGoal
    from rbtrg_robot.orders.order import follow

    with connect(robot) as bus:
        _tell(follow(bus, CancelGoal()))


def stop(robot: Robot = ROBOT) -> None:
    """Emergency stop: zero velocity, latched until `resume`. Sent until the robot confirms it."""
    from rbtrg_robot.cli.stop import stop as send

    raise typer.Exit(send(robot))


def resume(robot: Robot = ROBOT) -> None:
    """Release the emergency stop. After driving by hand: give the motion back to the stack."""
    from rbtrg_robot.cli.link import connect
    from rbtrg_robot.orders.order import follow
    from rbtrg_robot.orders.robot import Resume

    with connect(robot) as bus:
        _tell(follow(bus, Resume()))


def posture(
    what: Annotated[Literal["stand", "sit", "damp", "recover"], typer.Argument(help="What to do.")],
    timeout: Annotated[float, typer.Option(help="Give up after this many seconds.")] = 30.0,
    robot: Robot = ROBOT,
) -> None:
    """Stand up, sit down, go soft, or recover from a fall or a fault."""
    from rbtrg_robot.cli.link import connect
    from rbtrg_robot.orders.order import follow
    from rbtrg_robot.orders.robot import Posture

    order = Posture(what, timeout)
    shown = ""

    def show(_: Any) -> None:
        nonlocal shown
        if order.said != shown:
            shown = order.said
            say(shown)

    with connect(robot) as bus:
        end = follow(bus, order, show)
    if not end.ok:
        if not end.words:
            raise typer.Exit(1)
        _fail(end.words)
    if end.words:
        say(end.words)


def _tell(end: Any) -> None:
    """Say how an order ended; exit status 1 where it failed."""
    from rbtrg_robot.cli.link import see_also

    if not end.ok:
        _fail(f"{end.words}; {see_also()}" if "answer" in end.words or "confirm" in end.words else end.words)
    say(end.words)


def _fail(text: str) -> NoReturn:
    say(f"rbtrg-robot: {text}", error=True)
    raise typer.Exit(1)
