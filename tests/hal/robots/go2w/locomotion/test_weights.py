"""Policies of our own as files."""

import json
from pathlib import Path

import numpy as np
import pytest

from hal.robots.go2w import facts as go2w
from hal.robots.go2w.locomotion.policy import PolicyController
from hal.robots.go2w.locomotion.rlsar import PolicyParams
from hal.robots.go2w.locomotion.torchfile import Layer, PolicyError
from hal.robots.go2w.locomotion.weights import load_weights, save_weights

PARAMS = PolicyParams(
    rl_kp=(20.0,) * 16, rl_kd=(0.5,) * 16, action_scale=(0.25,) * 12 + (5.0,) * 4,
    default_dof_pos=tuple(go2w.STAND.tolist()),
    observations_history=(0, 3),
)  # fmt: skip


def layers(inputs: int = 114, outputs: int = 16) -> list[Layer]:
    rng = np.random.default_rng(0)
    first = Layer(rng.normal(size=(8, inputs)).astype(np.float32), np.zeros(8, np.float32), "ELU")
    return [
        first,
        Layer(rng.normal(size=(outputs, 8)).astype(np.float32), np.ones(outputs, np.float32), "Identity"),
    ]


def test_a_policy_comes_back_with_its_facts(tmp_path: Path) -> None:
    file = tmp_path / "p.npz"
    save_weights(file, PARAMS, layers(), {"hours": 2.5})
    params, back, facts = load_weights(file)
    assert (params, facts) == (PARAMS, {"hours": 2.5})
    for was, now in zip(layers(), back, strict=True):
        np.testing.assert_allclose(now.weight, was.weight, atol=2e-3)
        assert now.activation == was.activation
    assert PolicyController(file).description == PARAMS.described()


@pytest.mark.parametrize(
    ("made", "words"),
    [
        (layers(57), "do not map 114 numbers to 16"),
        (layers(114, 12), "do not map 114 numbers to 16"),
        ([], "holds no layers"),
        ([layer._replace(activation="Softmax") for layer in layers()], "activations other than"),
        ([layer._replace(bias=layer.bias * np.nan) for layer in layers()], "not finite"),
    ],
)
def test_layers_that_do_not_fit_are_refused(tmp_path: Path, made: list[Layer], words: str) -> None:
    save_weights(tmp_path / "p.npz", PARAMS, made, {})
    with pytest.raises(PolicyError, match=words):
        load_weights(tmp_path / "p.npz")


def test_other_files_are_refused_in_one_line(tmp_path: Path) -> None:
    with pytest.raises(PolicyError, match="does not exist"):
        load_weights(tmp_path / "none.npz")
    (tmp_path / "text.npz").write_text("no archive")
    with pytest.raises(PolicyError, match="is not a policy file"):
        load_weights(tmp_path / "text.npz")
    np.savez(tmp_path / "other.npz", header=np.array(json.dumps({"format": "rbtrg-policy-9"})))
    with pytest.raises(PolicyError, match="is of format rbtrg-policy-9"):
        load_weights(tmp_path / "other.npz")
    np.savez(tmp_path / "empty.npz", x=np.zeros(1))
    with pytest.raises(PolicyError, match="is not a policy file"):
        load_weights(tmp_path / "empty.npz")
