"""Physics on an accelerator. It needs MuJoCo Warp: `uv run --group train --group accelerator pytest -m campaign
tests/tools/train/test_warp.py`. Without a CUDA device it runs on the CPU."""

import numpy as np
import pytest

pytest.importorskip("mujoco_warp")

from tools.train.physics import Robots
from tools.train.settings import Physics
from tools.train.terrain import KINDS, OPEN
from tools.train.warp import WarpRobots

pytestmark = pytest.mark.campaign
KIND = np.array([OPEN, *range(len(KINDS)), OPEN, 0])


def placed(physics: type[Robots]) -> Robots:
    n = len(KIND)
    robots = physics(n, Physics(models=3), np.random.default_rng(1))
    middle = robots.ground.middle(KIND, np.full(n, 2))
    robots.place(np.arange(n), np.where(KIND == OPEN, 5.0, 0.0), middle, np.zeros(n), np.full(n, 0.3))
    return robots


def test_robots_drive_onto_all_kinds_of_ground_as_they_do_on_the_cores() -> None:
    exact, fast = placed(Robots), placed(WarpRobots)
    np.testing.assert_array_equal(exact.state, fast.state)
    forward = np.zeros((len(KIND), 16), np.float32)
    forward[:, 12:] = 1.5
    for _ in range(60):
        assert not exact.step(forward).any()
        assert not fast.step(forward).any()
    way = exact.state[:, 1] - np.where(KIND == OPEN, 5.0, 0.0)
    assert (way > 0.3).all()
    np.testing.assert_allclose(fast.state[:, 1:4], exact.state[:, 1:4], atol=0.1)
    np.testing.assert_allclose(fast.state[:, 0], exact.state[:, 0], atol=1e-9)


def test_a_robot_that_begins_anew_has_the_body_that_was_drawn_for_it() -> None:
    robots = placed(WarpRobots)
    robots.step(np.zeros((len(KIND), 16), np.float32))
    robots.drawn = (robots.drawn + 1) % 3
    robots.step(np.zeros((len(KIND), 16), np.float32))
    mass = robots._model.body_mass.numpy()
    np.testing.assert_allclose(mass, robots._tables["body_mass"][robots.drawn], rtol=1e-6)
