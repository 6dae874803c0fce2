"""`goal`, `cancel`, `stop`, `resume`, `posture`."""

from __future__ import annotations

import getpass
import math
import socket
import sys
import time
import uuid
from collections.abc import Iterator
from typing import Annotated, Any, Literal, NoReturn

import typer

Robot = Annotated[str, typer.Option("--robot", help="Name of the robot.")]
REACHED, REJECTED, ABORTED, CANCELLED, TIMED_OUT = 0, 2, 3, 4, 5
EXIT = {
    "reached": REACHED,
    "rejected": REJECTED,
    "aborted": ABORTED,
    "cancelled": CANCELLED,
    "preempted": CANCELLED,
}
POSTURES = {
    "stand": ("ready", "moving", "stopped"),
    "sit": ("sitting",),
    "damp": ("damped",),
    "recover": ("ready", "moving", "stopped"),
}
"""What may be asked for, and the phases that mean it is done."""
SETTLE = 1.0
"""Seconds until an answer counts as one to the order and not as the state before."""
RESEND = 0.5
REPEAT_ORDER = 0.1
"""Seconds between two sendings of a goal, of an order to the robot."""
ANSWER_LIMIT = 3.0
"""Seconds without any answer from the navigator."""


def register(app: typer.Typer) -> None:
    """Add the commands."""
    app.command(context_settings={"ignore_unknown_options": True})(goal)
    app.command()(cancel)
    app.command()(stop)
    app.command()(resume)
    app.command()(posture)


def goal(
    target: Annotated[
        list[str], typer.Argument(help="X Y in metres, frame map; or the NAME of one of the scene's goals.")
    ],
    yaw: Annotated[float | None, typer.Option(help="Heading at the goal [deg].")] = None,
    wait: Annotated[bool, typer.Option("--wait", help="Wait for the end.")] = False,
    timeout: Annotated[float, typer.Option(help="Give up after this many seconds; 0 = never.")] = 0.0,
    robot: Robot = "go2w",
) -> None:
    """Send the robot to a place. Exit status: 0 reached, 2 rejected, 3 aborted, 4 cancelled or preempted, 5 timed out."""
    from rbtrg_robot import topics as t
    from rbtrg_robot.cli.link import connect, scene
    from rbtrg_robot.stages.navigation.goal import goal_request

    x, y, goal_yaw, name = _target(target, scene(robot))
    if yaw is not None:
        goal_yaw = math.radians(yaw)
    if not all(math.isfinite(v) for v in (x, y, goal_yaw or 0.0, timeout)):
        print("rbtrg-robot: goal rejected: coordinates must be finite numbers", file=sys.stderr)
        raise typer.Exit(REJECTED)
    goal_id = uuid.uuid4().hex[:12]
    with connect(robot) as bus:
        bus.subscribe([t.GOAL_STATUS])
        request = goal_request(
            time.time_ns(), goal_id, x, y, goal_yaw, name=name, timeout=timeout, owner=me()
        )
        try:
            code = _follow(bus, goal_id, request, wait=wait, timeout=timeout)
        except KeyboardInterrupt:
            print("cancelling the goal", file=sys.stderr)
            _cancel(bus, goal_id)
            code = CANCELLED
        raise typer.Exit(code)


def me() -> str:
    """Who gives orders here, for whoever else is at the robot."""
    return f"{getpass.getuser()}@{socket.gethostname()}"


def _target(words: list[str], scene: str) -> tuple[float, float, float | None, str]:
    from rbtrg_robot.config import ConfigError

    if len(words) == 2:
        try:
            return float(words[0]), float(words[1]), None, ""
        except ValueError as error:
            raise ConfigError(f"a goal is X Y in metres or a NAME, got {' '.join(words)!r}") from error
    if len(words) != 1:
        raise ConfigError(f"a goal is X Y in metres or a NAME, got {' '.join(words)!r}")
    if not scene:
        raise ConfigError("named goals exist in scenes simulated on this computer only; give X Y")
    from hal.scenes import load_scene

    goals = load_scene(scene).goals
    if words[0] not in goals:
        raise ConfigError(f"scene {scene} has no goal {words[0]!r}; it has {', '.join(goals)}")
    x, y, yaw = goals[words[0]]
    return x, y, yaw, words[0]


def _follow(bus: Any, goal_id: str, request: Any, *, wait: bool, timeout: float) -> int:
    """Send until answered, then watch. Returns the exit status."""
    from rich.console import Console
    from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn

    from rbtrg_robot import topics as t
    from rbtrg_robot.cli.link import see_also
    from rbtrg_robot.stages.navigation.reasons import words

    console = Console(stderr=True)
    began = time.monotonic()
    sent = heard = -math.inf
    farthest = 0.0
    columns = (
        TextColumn("{task.description}"),
        BarColumn(),
        TextColumn("{task.fields[left]}"),
        TimeElapsedColumn(),
    )
    with Progress(
        *columns, console=console, transient=True, disable=not (wait and console.is_terminal)
    ) as bar:
        task = bar.add_task("goal", total=1.0, left="")
        while True:
            now = time.monotonic()
            if heard < began and now - sent > RESEND:
                sent = now
                bus.publish(t.GOAL_REQUEST, request, time.time_ns())
            if now - max(heard, began) > ANSWER_LIMIT + (10.0 if heard >= began else 0.0):
                print(f"rbtrg-robot: the navigator does not answer; {see_also()}", file=sys.stderr)
                return ABORTED
            if timeout and now - began > timeout + 10.0:
                print("rbtrg-robot: goal timed out", file=sys.stderr)
                return TIMED_OUT
            for received in bus.take(0.1):
                status = bus.open(received)
                if status is None or status.id != goal_id:
                    continue
                heard = time.monotonic()
                farthest = max(farthest, status.distance_left)
                done = 1.0 - status.distance_left / farthest if farthest else 0.0
                bar.update(
                    task, description=status.state, completed=done, left=f"{status.distance_left:.1f} m"
                )
                if status.state in EXIT:
                    why = words(status.reason, status.detail)
                    code = TIMED_OUT if status.reason == "timeout" else EXIT[status.state]
                    bar.stop()
                    print(
                        f"goal {status.state}" + (f": {why}" if why else ""),
                        file=sys.stderr if code else sys.stdout,
                    )
                    return code
                if not wait and status.state not in ("accepted", "planning"):
                    print(f"goal {status.state}")
                    return 0


def cancel(robot: Robot = "go2w") -> None:
    """Cancel the present goal, whoever sent it; the robot stops."""
    from rbtrg_robot import topics as t
    from rbtrg_robot.cli.link import connect, see_also

    with connect(robot) as bus:
        bus.subscribe([t.GOAL_STATUS])
        if not _cancel(bus, ""):
            _fail(f"the navigator does not answer; {see_also()}")


def _cancel(bus: Any, goal_id: str) -> bool:
    """Cancel this goal, or the present one where the id is empty, and say what became of it; False without an answer."""
    from rbtrg_robot import msg
    from rbtrg_robot import topics as t
    from rbtrg_robot.wire.messages import header

    deadline = time.monotonic() + ANSWER_LIMIT
    sent = -math.inf
    while time.monotonic() < deadline:
        if time.monotonic() - sent > RESEND:
            sent = time.monotonic()
            request = msg.GoalRequest(header=header(time.time_ns(), "map"), action=1, id=goal_id, owner=me())
            bus.publish(t.GOAL_REQUEST, request, time.time_ns())
        for received in bus.take(0.1):
            status = bus.open(received)
            if status is None or goal_id not in ("", status.id):
                continue
            if status.state == "cancelled":
                whose = f" of {status.owner}" if status.owner not in ("", me()) else ""
                print(f"goal{whose} cancelled")
                return True
            if status.state == "idle" or status.state in EXIT:
                print(
                    "no goal to cancel"
                    + (f"; the last one was {status.state}" if status.state in EXIT else "")
                )
                return True
    return False


def stop(robot: Robot = "go2w") -> None:
    """Emergency stop: zero velocity at once, latched until `resume`. Sent until the robot confirms it."""
    from rbtrg_robot.cli.stop import stop as send

    raise typer.Exit(send(robot))


def resume(robot: Robot = "go2w") -> None:
    """Release the emergency stop, and give the motion back to the stack after driving by hand."""
    latch = 0
    for state in _order(robot, "resume", ANSWER_LIMIT, named=True):
        if state.latch == 0:
            print("resumed" if latch else "nothing to resume")
            return
        latch = latch or state.latch
        if state.latch != latch:  # a stop that came after this order stays
            _fail(f"stopped again: {state.estop_cause or state.taken}; `rbtrg-robot resume` once more")
    from rbtrg_robot.cli.link import see_also

    _fail(f"the robot does not confirm `resume`; {see_also()}")


def posture(
    what: Annotated[Literal["stand", "sit", "damp", "recover"], typer.Argument(help="What to do.")],
    timeout: Annotated[float, typer.Option(help="Give up after this many seconds.")] = 30.0,
    robot: Robot = "go2w",
) -> None:
    """Stand up, sit down, go soft (damp), or recover from a fall or a fault."""
    start = time.monotonic()
    shown = ""
    for state in _order(robot, what, timeout):
        cause = f"{state.phase}: {state.cause}"
        if cause != shown:
            shown = cause
            print(cause)
        waited = time.monotonic() - start
        if waited < SETTLE:
            continue
        if f"{what} refused" in state.cause:
            _fail(state.cause)
        if state.cause.startswith("dry run"):  # the robot does not do it, and says so
            return
        if state.phase in POSTURES[what]:
            if state.phase == "stopped":
                print(f"it stands; `rbtrg-robot resume` lets it drive ({state.estop_cause})")
            return
        if state.phase == "fault" and waited > 4 * SETTLE:
            raise typer.Exit(1)
    _fail(f"no `{what}` within {timeout:.0f} s ({shown or 'the robot does not answer'})")


def _order(robot: str, mode: str, limit: float, *, named: bool = False) -> Iterator[Any]:
    """Repeat the order for `limit` seconds; what the robot says meanwhile (rbtrg_msgs/RobotState).

    `named`: for what is latched in the first state that is heard, and for nothing that comes later.
    """
    from rbtrg_robot import msg
    from rbtrg_robot import topics as t
    from rbtrg_robot.cli.link import connect
    from rbtrg_robot.wire.messages import header

    with connect(robot) as bus:
        bus.subscribe([t.ROBOT_STATE])
        bus.advertise(t.ROBOT_COMMAND)
        deadline = time.monotonic() + limit
        sent = -math.inf
        latch = None if named else 0
        while time.monotonic() < deadline:
            if time.monotonic() - sent > REPEAT_ORDER and latch is not None:
                sent = time.monotonic()
                stamp = header(time.time_ns(), "")
                order = msg.RobotCommand(header=stamp, mode=mode, cause="operator", latch=latch)
                bus.publish(t.ROBOT_COMMAND, order, time.time_ns())
            for received in bus.take(0.05):
                state = bus.open(received)
                if state is not None:
                    latch = state.latch if latch is None else latch
                    yield state


def _fail(text: str) -> NoReturn:
    print(f"rbtrg-robot: {text}", file=sys.stderr)
    raise typer.Exit(1)
