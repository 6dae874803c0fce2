"""A run: clone, learn, write checkpoints, curves and the policy as the robot reads it."""

from __future__ import annotations

import json
import time
from collections import deque
from concurrent.futures import ProcessPoolExecutor
from multiprocessing import get_context
from pathlib import Path
from typing import Any

import numpy as np
from rich.console import Console
from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn

from hal.robots.go2w.locomotion.weights import save_weights
from tools.train import curves
from tools.train.checkpoint import FILE, Checkpoint
from tools.train.cloning import fit
from tools.train.environment import KNOWN_COUNT, Environment
from tools.train.network import as_layers, normalised
from tools.train.physics import Robots
from tools.train.ppo import Experience, Learner
from tools.train.settings import PARAMS, Settings
from tools.train.teacher import episode, stacked
from tools.train.terrain import KINDS, OPEN

TEACHER_EPISODES = 104
"""Of the teacher."""
SAVE_EVERY = 120.0
"""Between checkpoints [s]."""
LOG, POLICY = "curves.jsonl", "policy.npz"
RECENT_EPISODES = 200
"""Episodes of a kind whose successes are averaged."""
WARM_AGAIN = 3
"""Iterations after an interruption in which the critic learns alone."""


def clone(
    settings: Settings, workers: int, out: Path, console: Console, episodes: int = TEACHER_EPISODES
) -> Checkpoint:
    """The first checkpoint: the teacher's policy."""
    began = time.process_time()
    seeds = [1000 * settings.seed + k for k in range(episodes)]
    with ProcessPoolExecutor(workers, mp_context=get_context("spawn")) as pool, _bar(console) as bar:
        task = bar.add_task("teacher drives", total=episodes, note="")
        drives = []
        for drive in pool.map(episode, seeds):
            drives.append(drive)
            bar.advance(task)
    seen = np.concatenate([stacked(frames) for frames, _ in drives])
    found = fit(seen, np.concatenate([outputs for _, outputs in drives]), seed=settings.seed)
    console.print(
        f"cloned from {len(seen) / 3000:.1f} min of driving, error {found.error:.3f} of the outputs' variance"
    )
    point = Checkpoint(settings, found.weights, None, None, found.mean, found.spread, None)
    point.seconds = time.process_time() - began
    point.save(out)
    return point


def train(
    point: Checkpoint,
    minutes: float,
    out: Path,
    console: Console,
    iterations: int | None = None,
    robots: type[Robots] = Robots,
) -> None:
    """Go on from a checkpoint for so many minutes (or iterations)."""
    settings, ppo = point.settings, point.settings.ppo
    # A seed of its own after each interruption: the same draws again would teach nothing new.
    seed = settings.seed + 1_000_003 * point.iteration
    rng = np.random.default_rng(seed)
    env = Environment(settings, ppo.robots, rng, robots)
    if point.level is not None:
        env.resume(point.level)
    learner = Learner(
        ppo, point.policy, point.mean, point.spread, seed, point.critic, point.log_std, point.rate
    )
    warm = point.iteration + (WARM_AGAIN if point.critic is not None else ppo.warm)
    recent: dict[int, deque[bool]] = {k: deque(maxlen=RECENT_EPISODES) for k in range(OPEN + 1)}
    began = saved = time.monotonic()
    before, done = point.seconds, 0
    _, known = env.observe()
    with _bar(console) as bar:
        task = bar.add_task("PPO", total=minutes * 60.0, note="")
        while (time.monotonic() - began < minutes * 60.0) if iterations is None else done < iterations:
            experience, known = _collect(env, learner, known, ppo.horizon)
            if point.iteration == warm:
                learner.begin()
            divergence, error = learner.learn(experience, point.iteration >= warm)
            done += 1
            point.iteration += 1
            point.steps += experience.reward.size
            point.seconds = before + time.monotonic() - began
            for kind, good in env.passed:
                recent[kind].append(good)
            env.passed.clear()
            line = {
                "iteration": point.iteration,
                "steps": point.steps,
                "seconds": round(point.seconds, 1),
                "reward": float(experience.reward.mean()) / settings.reward.scale,
                "divergence": divergence,
                "value_error": error,
                "rate": learner.rate,
                "std": float(np.exp(np.asarray(learner.actor["log_std"])).mean()),
                "level": env.levels(),
                "passed": {
                    name: float(np.mean(recent[k])) for k, name in enumerate((*KINDS, "open")) if recent[k]
                },
            }
            with (out / LOG).open("a") as file:
                file.write(json.dumps(line) + "\n")
            bar.update(task, completed=time.monotonic() - began, note=_note(line))
            if time.monotonic() - saved > SAVE_EVERY:
                saved = time.monotonic()
                _save(point, env, learner, out)
    _save(point, env, learner, out)
    curves.draw(out)
    console.print(
        f"{point.steps / 1e6:.1f} million steps in all; {out / POLICY}, {out / FILE}, {out / curves.PICTURE}"
    )


def _collect(env: Environment, learner: Learner, known: Any, horizon: int) -> tuple[Experience, Any]:
    """`horizon` steps of all robots."""
    n, gamma = len(known), learner.ppo.gamma
    e = Experience(
        known=np.empty((horizon, n, KNOWN_COUNT), np.float32),
        action=np.empty((horizon, n, 16), np.float32),
        chance=np.empty((horizon, n), np.float32),
        mean=np.empty((horizon, n, 16), np.float32),
        value=np.empty((horizon + 1, n), np.float32),
        reward=np.empty((horizon, n), np.float32),
        ended=np.empty((horizon, n), bool),
    )
    for t in range(horizon):
        e.known[t] = known
        e.action[t], e.chance[t], e.mean[t], e.value[t] = learner.act(known)
        reward, fault, over = env.step(e.action[t])
        # Time ended it, not the robot: what would have come counts as much as where it was.
        e.reward[t] = reward + gamma * np.where(over, e.value[t], 0.0)
        e.ended[t] = fault | over
        _, known = env.observe()
    e.value[horizon] = learner.value(known)
    return e, known


def _save(point: Checkpoint, env: Environment, learner: Learner, out: Path) -> None:
    point.policy = [(np.asarray(w), np.asarray(b)) for w, b in learner.actor["net"]]
    point.critic = [(np.asarray(w), np.asarray(b)) for w, b in learner.critic]
    point.log_std = np.asarray(learner.actor["log_std"])
    point.level, point.rate = env.level.copy(), learner.rate
    point.save(out)
    export(point, out / POLICY)


def export(point: Checkpoint, file: Path) -> None:
    """The policy as the robot reads it."""
    facts = {
        "trained": {
            "million_steps": round(point.steps / 1e6, 2),
            "hours": round(point.seconds / 3600.0, 2),
            "settings": point.settings.model_dump(mode="json"),
        }
    }
    save_weights(file, PARAMS, as_layers(normalised(point.policy, point.mean, point.spread)), facts)


def _bar(console: Console) -> Progress:
    return Progress(
        TextColumn("{task.description}"), BarColumn(), TimeElapsedColumn(), TextColumn("{task.fields[note]}"),
        console=console, transient=True,
    )  # fmt: skip


def _note(line: dict[str, Any]) -> str:
    levels = " ".join(f"{name} {value:.1f}" for name, value in line["level"].items())
    return f"{line['steps'] / 1e6:.2f} M steps, reward {line['reward']:.2f}, levels {levels}"
