"""The learner. It needs JAX: `uv run --group train pytest tests/tools/train`."""

from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("jax")
pytest.importorskip("optax")

from rich.console import Console

from hal.robots.go2w.locomotion.network import forward
from hal.robots.go2w.locomotion.policy import PolicyController
from tools.train import network, perceptron, ppo
from tools.train.checkpoint import Checkpoint
from tools.train.cloning import fit
from tools.train.environment import SEEN
from tools.train.run import train
from tools.train.settings import POLICY_LAYERS, Physics, Ppo, Settings


def test_advantages_of_three_steps_by_hand() -> None:
    experience = ppo.Experience(
        known=np.zeros((3, 1, 1), np.float32), action=np.zeros((3, 1, 16), np.float32),
        chance=np.zeros((3, 1), np.float32),
        mean=np.zeros((3, 1, 16), np.float32), value=np.array([[1.0], [2.0], [3.0], [4.0]], np.float32),
        reward=np.array([[1.0], [1.0], [1.0]], np.float32), ended=np.array([[False], [True], [False]]),
    )  # fmt: skip
    gain, returns = ppo.advantages(experience, 0.5, 0.5)
    # Last: 1 + .5*4 - 3 = 0. Middle, where a robot began anew: 1 - 2 = -1. First: 1 + .5*2 - 1 = 1, and .25 of -1.
    np.testing.assert_allclose(gain[:, 0], [0.75, -1.0, 0.0])
    np.testing.assert_allclose(returns[:, 0], [1.75, 1.0, 3.0])


def test_a_clone_follows_its_teacher() -> None:
    rng = np.random.default_rng(0)
    seen = rng.normal(size=(4096, SEEN)).astype(np.float32)
    seen[:, 16:] = 0.0
    found = fit(seen, np.tanh(seen[:, :16]) * 2.0, epochs=150)
    assert found.error < 0.1, "an untrained one has 1"


def test_exported_layers_do_what_the_trained_ones_do() -> None:
    rng = np.random.default_rng(1)
    weights = network.fresh([SEEN, *POLICY_LAYERS, 16], 1.0, rng)
    mean, spread = rng.normal(size=SEEN).astype(np.float32), rng.uniform(0.1, 2.0, SEEN).astype(np.float32)
    x = rng.normal(size=SEEN).astype(np.float32)
    wanted = np.asarray(perceptron.forward(perceptron.as_tree(weights), (x - mean) / spread))
    got = forward(network.as_layers(network.normalised(weights, mean, spread)), x)
    np.testing.assert_allclose(got, wanted, atol=1e-3)


def test_a_run_goes_on_where_it_was_interrupted(tmp_path: Path) -> None:
    settings = Settings(physics=Physics(models=1), ppo=Ppo(robots=8, horizon=4, batches=2, epochs=1, warm=1))
    rng = np.random.default_rng(0)
    weights = network.fresh([SEEN, *POLICY_LAYERS, 16], 0.01, rng)
    point = Checkpoint(
        settings, weights, None, None, np.zeros(SEEN, np.float32), np.ones(SEEN, np.float32), None
    )
    train(point, 1.0, tmp_path, Console(quiet=True), iterations=3)
    first = Checkpoint.load(tmp_path)
    assert (first.iteration, first.steps) == (3, 96)
    assert not np.array_equal(first.policy[0][0], weights[0][0]), "it learnt"
    train(first, 1.0, tmp_path, Console(quiet=True), iterations=2)
    assert Checkpoint.load(tmp_path).iteration == 5
    assert len((tmp_path / "curves.jsonl").read_text().splitlines()) == 5
    assert (tmp_path / "curves.png").stat().st_size > 5000
    assert PolicyController(tmp_path / "policy.npz").network.inputs == SEEN
