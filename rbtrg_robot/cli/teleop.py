"""`teleop`: drive by hand from a terminal."""

from __future__ import annotations

import os
import select
import sys
import time
from typing import Annotated, Any

import typer

from rbtrg_robot.scope import NAMED, ROBOT
from rbtrg_robot.terminal import overwrite, say

Robot = Annotated[str, typer.Option("--robot", envvar=NAMED, help="Name of the robot.")]
COMMAND_PERIOD = 0.05
"""[s] between two velocities; the robot lets go after 0.2 s of silence."""
HELP = "w a s d or arrows drive while held, + - speed, space or Esc STOP, r resume the stack, q quit"


def register(app: typer.Typer) -> None:
    """Add the command."""
    app.command()(teleop)


def teleop(
    speed: Annotated[
        float, typer.Option(min=0.1, max=1.0, help="Forward [m/s]; turns at twice as many rad/s.")
    ] = 0.4,
    robot: Robot = ROBOT,
) -> None:
    """Drive by hand with the keys of this terminal. A goal waits until `resume`; the guard brakes hands too."""
    from rbtrg_robot import topics as t
    from rbtrg_robot.cli.link import connect
    from rbtrg_robot.config import ConfigError

    if not sys.stdin.isatty():
        raise ConfigError("teleop reads keys: run it in a terminal")
    import termios
    import tty

    before = termios.tcgetattr(sys.stdin)
    with connect(robot) as bus:
        bus.subscribe([t.ROBOT_STATE, t.MOTION_LIMITS])
        for topic in (t.TELEOP, t.ROBOT_STOP, t.ROBOT_COMMAND):
            bus.advertise(topic)
        tty.setcbreak(sys.stdin)
        try:
            say(HELP)
            _drive(bus, speed)
        finally:
            termios.tcsetattr(sys.stdin, termios.TCSADRAIN, before)
            say()


def _drive(bus: Any, speed: float) -> None:
    from rbtrg_robot import topics as t
    from rbtrg_robot.orders.keys import FASTER, KEYS, QUIT, RESUME, SLOWER, STOP_KEYS, HeldKeys
    from rbtrg_robot.orders.order import Order, send
    from rbtrg_robot.orders.robot import Resume, Stop
    from rbtrg_robot.wire.messages import stamp_of

    held, state, limits = HeldKeys(), None, None
    driving = leaving = False
    said = ""
    active: Order | None = None
    while True:
        now = time.monotonic()
        for key in _keys():
            if key in QUIT:
                held.clear()
                leaving = True
            elif key in STOP_KEYS:
                held.clear()
                active = Stop()
            elif key == RESUME:
                active = Resume()
            elif key in (FASTER, SLOWER):
                speed = min(1.0, max(0.1, speed + (0.1 if key == FASTER else -0.1)))
            elif key in KEYS:
                held.press(key, now)
        if active is not None:
            send(bus, active)
        want = held.want(now)
        if want is not None or driving:
            forward, left = want or (0.0, 0.0)
            seen = 0 if state is None else stamp_of(state)
            bus.publish(t.TELEOP, _velocity(speed * forward, speed * left, seen), time.time_ns())
            driving = want is not None
        for received in bus.take(COMMAND_PERIOD):
            message = bus.open(received)
            if message is None:
                continue
            if received.topic is t.ROBOT_STATE:
                state = message
            else:
                limits = message
            if active is not None and received.topic in active.hears:
                active.take(received.topic, message)
        words = _words(state, limits, speed, active, now)
        if words != said:
            said = words
            overwrite(words)
        if active is not None and active.outcome is not None:
            overwrite("")
            say(active.outcome.words)
            active = None
        if leaving and active is None and not driving:
            return
        time.sleep(max(0.0, now + COMMAND_PERIOD - time.monotonic()))


def _keys() -> list[str]:
    """What was typed since the last look; an arrow is one key."""
    if not select.select([sys.stdin], [], [], 0.0)[0]:
        return []
    text = os.read(sys.stdin.fileno(), 256).decode(errors="ignore")
    keys = []
    while text:
        size = 3 if text[:2] == "\x1b[" and len(text) > 2 else 1
        keys.append(text[:size])
        text = text[size:]
    return keys


def _velocity(forward: float, left: float, seen: int) -> Any:
    """geometry_msgs/TwistStamped in base_link; `forward` in m/s, `left` in half rad/s; `seen`: newest stamp received
    from the robot [ns]."""
    from rbtrg_robot import msg
    from rbtrg_robot.wire.messages import header

    message = msg.TwistStamped(header=header(seen, "base_link"))
    message.twist.linear.x = forward
    message.twist.angular.z = 2.0 * left
    return message


def _words(state: Any, limits: Any, speed: float, active: Any, now: float) -> str:
    """One line: what is let through, and why no more."""
    from rbtrg_robot.orders.limits import USE_HARDWARE
    from rbtrg_robot.orders.robot import Stop
    from rbtrg_robot.orders.words import held, slowed

    if isinstance(active, Stop) and active.worried(now):
        return f"STOP NOT CONFIRMED: {USE_HARDWARE}"
    if state is None:
        return "the robot is not heard yet"
    words = [f"{state.vx:.2f} m/s {state.wz:.2f} rad/s (up to {speed:.1f})", state.phase]
    if state.hands >= 0.0:
        words.append(f"link {1000 * state.hands:.0f} ms")
    if state.estop:
        words.append(f"E-STOP ({state.estop_cause})")
    else:
        words.append(held(state.hold))
    words.append(slowed(limits.reason) if limits is not None else "")
    return ", ".join(filter(None, words))
