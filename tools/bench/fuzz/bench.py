"""Messages mutated from a real drive, on every topic that somebody subscribes to: nothing ends, nothing grows.

Each target runs in a process of its own, so that an abort in native code is seen too. A message counts when it was
handed over, whether it was
refused or taken.
"""

from __future__ import annotations

import argparse
import faulthandler
import logging
import multiprocessing
import resource
import signal
import tempfile
import time
import traceback
from collections import Counter
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import psutil

from hal.types import NS
from rbtrg_robot import msg
from rbtrg_robot import topics as t
from rbtrg_robot.config import StackConfig, load
from rbtrg_robot.hosts.lockstep import Lockstep
from rbtrg_robot.topics import Topic
from rbtrg_robot.wire.convert import BASE, MAP
from rbtrg_robot.wire.messages import decode, encode, header
from tools.bench.fuzz.mutate import Mutator
from tools.bench.fuzz.targets import TARGETS, Samples, newest_stamp
from tools.bench.report import Report
from tools.bench.spread import shielded

KEPT_MESSAGES = 12
"""Messages of a topic that mutations start from."""
TURN_MESSAGES = 20
"""Messages between two turns of a target."""
SOUND_SHARE = 0.2
"""Share of messages that stay as they were recorded: what a target keeps must meet what is broken."""
MESSAGE_TIME = 20
"""Longest [s] that one message may take."""
MEMORY_LIMIT = 6 * 2**30
"""Address space of a target [bytes]."""
GROWTH_MB = 40.0
"""Growth of a process over the second half of its messages that counts as unbounded [MB]."""


class Hangs(Exception):
    """One message took longer than MESSAGE_TIME."""


def fuzz_config() -> StackConfig:
    """The default robot with few LiDAR points: what is mutated is the layout, not the number of points."""
    return load(None, ["sim.lidar_step=40"], scene="yard", map_file="")


def record(config: StackConfig, seconds: float = 6.0) -> Samples:
    """A drive to a goal with commands in it, and what people send beside it: payloads by topic."""
    samples: Samples = {}
    with Lockstep(config) as stack:

        def keep(topic: Topic, payload: bytes, _now: int) -> None:
            kept = samples.setdefault(topic, [])
            kept.append(payload)
            if len(kept) > 4 * KEPT_MESSAGES:  # thin out, so that the whole drive is in it
                del kept[::2]

        stack.host.listen(keep)
        stack.wait_ready()
        stack.send_goal(2.0, 0.5)
        stack.run(0.6 * seconds)
        stack.command("stop")
        stack.run(0.2)
        stack.command("resume")
        stack.run(0.4 * seconds)
        for topic, message in by_people(stack.now):
            stack.host.inject(topic, message)
            stack.run(0.2)
    samples.setdefault(t.MAP_MIRROR, samples[t.MAP_PARTS])
    maps = [decode(payload, msg.GridMap) for payload in samples[t.MAP_FULL]]
    prior = msg.MapPrior(
        header=maps[0].header, id="fuzz", map=maps, cloud=decode(samples[t.MAP_CLOUD][0], msg.PointCloud2)
    )
    samples[t.MAP_PRIOR] = [encode(prior)]
    blank = [topic for topic in t.TOPICS if topic not in samples]
    samples |= {topic: [Mutator.blank(topic)] for topic in blank}
    return samples


def by_people(now: int) -> list[tuple[Topic, Any]]:
    """What a drive to a goal has not: maps asked for, a mission, a question, places told, teleoperation; [ns]."""
    place = msg.Pose(position=msg.Point(x=1.0, y=0.2))
    placed = msg.PoseWithCovarianceStamped(header=header(now, MAP))
    placed.pose.pose = place
    steps = [
        msg.MissionStep(id="s1", kind="wait", blocking_type="HARD", on_failure="stop", duration=0.2),
        msg.MissionStep(
            id="s2", kind="ask", blocking_type="HARD", on_failure="skip", text="on?", choices=["yes", "no"]
        ),
        msg.MissionStep(
            id="s3", kind="goto", blocking_type="HARD", on_failure="retry", retries=1, x=1.0, timeout=9.0
        ),
    ]
    order = msg.MissionOrder(
        order_id="o1",
        name="round",
        frame=MAP,
        on_comms_loss="continue",
        comms_timeout=5.0,
        start=1,
        steps=steps,
    )
    stamp = header(now, BASE)
    return [
        (t.MAP_REQUEST, msg.MapRequest(header=header(now, MAP), action="full")),
        (t.MAP_REQUEST, msg.MapRequest(header=header(now, MAP), action="parts")),
        (t.ROUTE_QUESTION, msg.RouteQuestion(header=header(now, MAP), id="q1", goal_x=2.0, goal_y=0.5)),
        (t.PRESENCE, msg.Presence(header=stamp, owner="p1")),
        (t.MISSION_REQUEST, msg.MissionRequest(id="1", owner="p1", action="run", order=order)),
        (
            t.MISSION_REQUEST,
            msg.MissionRequest(id="2", owner="p1", action="answer", order_id="o1", step=2, answer="yes"),
        ),
        (t.INITIAL_POSE, placed),
        (t.GOAL_POSE, msg.PoseStamped(header=header(now, MAP), pose=place)),
        (t.TELEOP, msg.TwistStamped(header=stamp, twist=msg.Twist(linear=msg.Vector3(x=0.2)))),
        (t.TRUNK, msg.TrunkCommand(header=stamp, pitch=0.1)),
        (t.TELEOP_TRUNK, msg.TrunkCommand(header=stamp, roll=-0.1, pitch=0.2)),
    ]


def fuzz(
    name: str, samples: Samples, messages: int, seed: int, config: StackConfig, folder: Path
) -> tuple[int, Counter[str], dict[str, str], float]:
    """(messages given, crashes by place, a trace of each, growth [MB]) of one target."""
    target = TARGETS[name](config, samples, folder)
    mutator = Mutator(seed, samples)
    crashes: Counter[str] = Counter()
    traces: dict[str, str] = {}
    memory = 0.0
    now = newest_stamp(samples)
    try:
        for number in range(messages):
            if number == messages // 2:
                memory = psutil.Process().memory_info().rss
            topic, payload = mutator.draw(target.inputs, SOUND_SHARE)
            try:
                with patience():
                    target.take(topic, payload)
                    if number % TURN_MESSAGES == TURN_MESSAGES - 1:
                        now += NS // 20
                        target.turn(now)
            except Exception as error:  # noqa: BLE001 - whatever gets here would have ended the process
                where = traceback.extract_tb(error.__traceback__)[-1]
                place = f"{topic.name}: {type(error).__name__} in {Path(where.filename).name}:{where.lineno}"
                crashes[place] += 1
                traces.setdefault(place, traceback.format_exc())
                target.close()
                target = TARGETS[name](config, samples, folder)
        grown = (psutil.Process().memory_info().rss - memory) / 2**20
    finally:
        target.close()
    return messages, crashes, traces, grown


@contextmanager
def patience() -> Iterator[None]:
    """Raises Hangs in the middle of what takes too long. Compiled code cannot be interrupted: it ends the process, with
    a trace."""

    def tell(_number: int, _frame: Any) -> None:
        raise Hangs(f"longer than {MESSAGE_TIME} s")

    signal.signal(signal.SIGALRM, tell)
    signal.setitimer(signal.ITIMER_REAL, MESSAGE_TIME)
    faulthandler.dump_traceback_later(3 * MESSAGE_TIME, exit=True)
    try:
        yield
    finally:
        faulthandler.cancel_dump_traceback_later()
        signal.setitimer(signal.ITIMER_REAL, 0)


def run(args: list[str]) -> Report:
    """Run this bench with the arguments of its command line; returns its rows."""
    parser = argparse.ArgumentParser(prog="python -m tools.bench fuzz", description=__doc__)
    parser.add_argument("--messages", type=int, default=1_000_000, help="of all targets together")
    parser.add_argument("--only", nargs="*", choices=TARGETS, default=list(TARGETS), metavar="TARGET")
    parser.add_argument("--seed", type=int, default=0)
    options = parser.parse_args(args)
    report = Report("fuzz")
    config = fuzz_config()
    samples = record(config)
    print(f"recorded {sum(map(len, samples.values()))} messages of {len(samples)} topics", flush=True)
    total, broken, each = 0, 0, -(-options.messages // len(options.only))
    context = multiprocessing.get_context("spawn")
    for name in options.only:
        began = time.monotonic()
        with tempfile.TemporaryDirectory() as folder:
            ours, theirs = context.Pipe(duplex=False)
            payloads = {topic.name: kept for topic, kept in samples.items()}
            process = context.Process(
                target=_alone, args=(theirs, name, payloads, each, options.seed, folder)
            )
            try:
                with shielded():
                    process.start()
                theirs.close()
                given, crashes, traces, grown = ours.recv()
            except EOFError:
                given, crashes, traces, grown = 0, Counter({"the process ended": 1}), {}, 0.0
            except KeyboardInterrupt:
                process.kill()
                raise
            process.join()
        total += given
        broken += sum(crashes.values())
        for place, count in crashes.most_common():
            print(f"{name}: {count} x {place}\n{traces.get(place, '')}", flush=True)
        print(
            f"{name}: {given} messages in {time.monotonic() - began:.0f} s, {sum(crashes.values())} crashes",
            flush=True,
        )
        report.add(f"messages.{name}", given, "-")
        report.add(f"crashes.{name}", sum(crashes.values()), "-", 0.0)
        report.add(f"growth_mb.{name}", grown, "MB", GROWTH_MB)
        report.add(f"s.{name}", time.monotonic() - began, "s")
    report.add("messages", total, "-")
    report.add("crashes", broken, "-", 0.0)
    return report


def _alone(
    pipe: Any, name: str, payloads: dict[str, list[bytes]], messages: int, seed: int, folder: str
) -> None:
    """In a process of its own. A topic is known by being the same object: between processes it travels as its name."""
    faulthandler.enable()
    logging.disable(logging.CRITICAL)
    resource.setrlimit(resource.RLIMIT_AS, (MEMORY_LIMIT, MEMORY_LIMIT))
    samples = {t.BY_NAME[key]: kept for key, kept in payloads.items()}
    pipe.send(fuzz(name, samples, messages, seed, fuzz_config(), Path(folder)))
