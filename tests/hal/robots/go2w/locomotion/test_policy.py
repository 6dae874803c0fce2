"""The policy runner reads rl_sar's files without torch, explains bad ones, and drives the simulated robot."""

from __future__ import annotations

import contextlib
import io
import pickle
import shutil
import zipfile
from pathlib import Path

import numpy as np
import pytest
import yaml
from hypothesis import given, settings
from hypothesis import strategies as st

from hal.lowlevel import LowState
from hal.mujoco.sim import Simulation
from hal.robots.go2w import facts as go2w
from hal.robots.go2w.locomotion.network import Perceptron, forward
from hal.robots.go2w.locomotion.policy import SETTLE_TIME, PolicyController
from hal.robots.go2w.locomotion.torchfile import Layer, PolicyError, read_mlp
from hal.types import PostureCommand, VelocityCommand
from tests.places import POLICY, needs_shared

# --- a small policy of our own, written the way torch writes one ---------------------------------------------------


class _Pickler:
    """Just enough of torch's pickle, protocol 2, written opcode by opcode through stand-in classes."""

    def __init__(self) -> None:
        self.storages: list[bytes] = []

    def tensor(self, array: np.ndarray) -> bytes:
        key = str(len(self.storages))
        self.storages.append(np.ascontiguousarray(array, "<f4").tobytes())
        strides = [s // array.itemsize for s in np.ascontiguousarray(array).strides]
        return (
            b"ctorch._utils\n_rebuild_tensor_v2\n(("
            + self.text("storage")
            + b"ctorch\nFloatStorage\n"
            + self.text(key)
            + self.text("cpu")
            + self.integer(array.size)
            + b"tQ"
            + self.integer(0)
            + b"("
            + b"".join(self.integer(n) for n in array.shape)
            + b"t("
            + b"".join(self.integer(n) for n in strides)
            + b"t\x89ccollections\nOrderedDict\n)RtR"
        )

    @staticmethod
    def text(value: str) -> bytes:
        return b"X" + len(value).to_bytes(4, "little") + value.encode()

    @staticmethod
    def integer(value: int) -> bytes:
        return b"J" + value.to_bytes(4, "little", signed=True)

    def module(self, kind: str, members: dict[str, bytes]) -> bytes:
        body = b"".join(self.text(name) + value for name, value in members.items())
        return (
            f"c__torch__.x\n{kind}\n".encode() + b")\x81}(" + self.text("training") + b"\x89" + body + b"ub"
        )


def write_policy(path: Path, layers: list[Layer], prefix: bytes = b"") -> None:
    p = _Pickler()
    members: dict[str, bytes] = {}
    for k, (weight, bias, activation) in enumerate(layers):
        members[str(2 * k)] = p.module("Linear", {"weight": p.tensor(weight), "bias": p.tensor(bias)})
        if activation != "Identity":
            members[str(2 * k + 1)] = p.module(activation, {})
    tree = p.module("Exporter", {"actor": p.module("MLP", members), "normalizer": p.module("Identity", {})})
    with zipfile.ZipFile(path, "w") as archive:
        archive.writestr("net/data.pkl", b"\x80\x02" + prefix + tree + b".")
        for k, data in enumerate(p.storages):
            archive.writestr(f"net/data/{k}", data)


def small_layers() -> list[Layer]:
    rng = np.random.default_rng(1)
    sizes = [(32, 57, "ELU"), (24, 32, "ReLU"), (16, 24, "Identity")]
    return [
        Layer(rng.normal(0, 0.3, (n, m)).astype(np.float32), rng.normal(0, 0.1, n).astype(np.float32), act)
        for n, m, act in sizes
    ]


CONFIG = {
    "go2w/test": {
        "num_observations": 57,
        "rl_kp": [20.0] * 12 + [0.0] * 4,
        "rl_kd": [0.5] * 16,
        "action_scale": [0.125, 0.25, 0.25] * 4 + [5.0] * 4,
        "default_dof_pos": [0.0, 0.8, -1.5] * 4 + [0.0] * 4,
    }
}


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    write_policy(tmp_path / "policy.pt", small_layers())
    (tmp_path / "config.yaml").write_text(yaml.safe_dump(CONFIG))
    return tmp_path


def stand_state(time: float = 0.0) -> LowState:
    rng = np.random.default_rng(4)
    quaternion = np.array([0.97, 0.1, -0.15, 0.2])
    return LowState(
        time,
        go2w.STAND + rng.normal(0, 0.1, 16),
        rng.normal(0, 1.0, 16),
        np.zeros(16),
        quaternion / np.linalg.norm(quaternion),
        rng.normal(0, 0.5, 3),
        np.array([0, 0, 9.81]),
    )


def test_layers_come_back_bit_exact(folder: Path) -> None:
    read = read_mlp(folder / "policy.pt")
    for mine, back in zip(small_layers(), read, strict=True):
        np.testing.assert_array_equal(mine.weight, back.weight)
        np.testing.assert_array_equal(mine.bias, back.bias)
        assert mine.activation == back.activation


def test_forward_matches_double_precision() -> None:
    layers = small_layers()
    x = np.random.default_rng(2).normal(0, 1, 57)
    y = x
    for weight, bias, activation in layers:
        y = weight.astype(float) @ y + bias.astype(float)
        if activation == "ELU":
            y = np.array([v if v > 0 else np.exp(v) - 1 for v in y])
        if activation == "ReLU":
            y = np.array([max(v, 0.0) for v in y])
    np.testing.assert_allclose(forward(layers, x.astype(np.float32)), y, atol=1e-5)


def test_observation_and_targets_follow_the_layout(folder: Path) -> None:
    controller = PolicyController(folder)
    state = stand_state()
    first = controller.step(state, VelocityCommand(0, 0.5, 0.0, -0.3), PostureCommand(0))
    q, dq = first.q.copy(), first.dq.copy()
    w, x, y, z = state.quaternion
    r = np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
            [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
            [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
        ]
    )
    default = go2w.STAND
    angles = state.q - default
    angles[12:] = 0.0
    observation = np.concatenate(
        [0.25 * state.gyro, r.T @ [0, 0, -1], [0.5, 0.0, -0.3], angles, 0.05 * state.dq, np.zeros(16)]
    )
    action = forward(small_layers(), observation.astype(np.float32))
    scale = np.array(CONFIG["go2w/test"]["action_scale"])
    np.testing.assert_allclose(q[:12], default[:12] + (action * scale)[:12], atol=1e-5)
    np.testing.assert_allclose(dq[12:], (action * scale)[12:], atol=1e-4)
    np.testing.assert_array_equal(first.kp, CONFIG["go2w/test"]["rl_kp"])


def test_the_network_runs_at_every_fourth_tick(folder: Path) -> None:
    controller = PolicyController(folder)
    assert controller.period == 0.005
    seen = []
    for k in range(9):
        state = stand_state(0.005 * k)
        state.gyro[:] = k
        command = controller.step(state, VelocityCommand(0, 0.5), PostureCommand(0))
        seen.append(command.q[0])
    changes = [k for k in range(1, 9) if seen[k] != seen[k - 1]]
    assert changes == [4, 8]


def test_zero_command_ends_in_a_joint_hold_and_a_command_leaves_it(folder: Path) -> None:
    controller = PolicyController(folder)
    state = stand_state(0.0)
    controller.step(state, VelocityCommand(0), PostureCommand(0))
    state.time = SETTLE_TIME + 0.01
    for k in range(200):
        state.time = SETTLE_TIME + 0.01 + 0.005 * k
        held = controller.step(state, VelocityCommand(0), PostureCommand(0))
    np.testing.assert_array_equal(held.q, state.q)
    np.testing.assert_array_equal(held.dq, np.zeros(16))
    assert held.kp[12] > 0.0, "wheels hold their place"
    moving = controller.step(state, VelocityCommand(0, 0.3), PostureCommand(0))
    assert moving.kp[12] == 0.0


# --- what is wrong with a policy, in words ---------------------------------------------------------------------------


def edited(folder: Path, **changes: object) -> Path:
    tree = {"go2w/test": {**CONFIG["go2w/test"], **changes}}
    (folder / "config.yaml").write_text(yaml.safe_dump(tree))
    return folder


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"rl_kp": [1.0] * 12}, "rl_kp must hold 16 numbers"),
        ({"default_dof_pos": [float("nan")] * 16}, "default_dof_pos must hold 16 numbers"),
        ({"observations": ["lin_vel", "commands"]}, "observations: lin_vel: there is ang_vel"),
        ({"num_observations": 45}, "observations are 57 numbers"),
        ({"observations_history": [0, 0]}, "each once"),
        ({"observations_history": [0, 100]}, "from 0 to 99"),
        ({"observations_history": [0, 1]}, "should map 114 to 16"),
        ({"joint_mapping": [3, 3, 5, 0, 1, 2, *range(6, 16)]}, "one stands twice"),
        ({"wheel_indices": [3, 7, 11, 15]}, "wheel_indices must be"),
        ({"model_name": "../policy.pt"}, "must lie in the same folder"),
        ({"decimation": 0}, "decimation"),
        ({"model_name": "other.pt"}, "does not exist"),
    ],
)
def test_a_config_that_does_not_fit_is_explained(
    folder: Path, changes: dict[str, object], words: str
) -> None:
    with pytest.raises(PolicyError, match=words):
        PolicyController(edited(folder, **changes))


def test_missing_things_are_named(tmp_path: Path, folder: Path) -> None:
    with pytest.raises(PolicyError, match=r"nowhere does not exist"):
        PolicyController(tmp_path / "nowhere")
    (folder / "config.yaml").unlink()
    with pytest.raises(PolicyError, match="holds no description of a policy"):
        PolicyController(folder)
    (folder / "config.yaml").write_text("a: [1, 2")
    with pytest.raises(PolicyError, match="cannot be read"):
        PolicyController(folder)


def test_a_network_of_the_wrong_size_is_refused(folder: Path) -> None:
    layers = small_layers()
    write_policy(folder / "policy.pt", [layers[0]._replace(weight=layers[0].weight[:, :50]), *layers[1:]])
    with pytest.raises(PolicyError, match="maps 50 to 16"):
        PolicyController(folder)


def test_a_file_that_would_run_code_is_refused(folder: Path) -> None:
    class Bomb:
        def __reduce__(self) -> tuple[object, tuple[str]]:
            return eval, ("1/0",)

    buffer = io.BytesIO()
    pickle.dump(Bomb(), buffer, protocol=2)
    with zipfile.ZipFile(folder / "policy.pt", "w") as archive:
        archive.writestr("net/data.pkl", buffer.getvalue())
    with pytest.raises(PolicyError, match="only a scripted plain MLP"):
        PolicyController(folder)


def test_an_unknown_layer_is_refused(folder: Path) -> None:
    p = _Pickler()
    tree = p.module("Exporter", {"actor": p.module("LSTM", {})})
    with zipfile.ZipFile(folder / "policy.pt", "w") as archive:
        archive.writestr("net/data.pkl", b"\x80\x02" + tree + b".")
    with pytest.raises(PolicyError, match="LSTM is not supported"):
        PolicyController(folder)


@settings(max_examples=60, deadline=None)
@given(data=st.data())
def test_a_damaged_file_gives_a_policy_error_and_nothing_else(
    data: st.DataObject, tmp_path_factory: pytest.TempPathFactory
) -> None:
    path = tmp_path_factory.mktemp("damaged") / "policy.pt"
    write_policy(path, small_layers())
    raw = bytearray(path.read_bytes())
    if data.draw(st.booleans()):
        raw = raw[: data.draw(st.integers(0, len(raw) - 1))]
    else:
        for _ in range(data.draw(st.integers(1, 20))):
            # The head holds the pickle, where damage is worst.
            raw[data.draw(st.integers(0, min(1500, len(raw) - 1)))] = data.draw(st.integers(0, 255))
    path.write_bytes(bytes(raw))
    with contextlib.suppress(PolicyError):
        layers = read_mlp(path)
        assert all(np.isfinite(layer.weight).all() for layer in layers)


# --- the shipped policy ---------------------------------------------------------------------------------------------


@needs_shared
def test_the_shipped_policy_has_the_published_shape() -> None:
    network = PolicyController(POLICY).network
    assert isinstance(network, Perceptron)
    layers = network.layers
    assert [layer.weight.shape for layer in layers] == [(512, 57), (256, 512), (128, 256), (16, 128)]
    assert [layer.activation for layer in layers] == ["ELU", "ELU", "ELU", "Identity"]
    assert sum(layer.weight.size + layer.bias.size for layer in layers) == 195_984


@needs_shared
def test_a_copy_with_the_base_file_one_folder_up_works(tmp_path: Path) -> None:
    inner = tmp_path / "robot_lab"
    inner.mkdir()
    shutil.copy(POLICY / "policy.pt", inner)
    shutil.copy(POLICY / "config.yaml", inner)
    (tmp_path / "base.yaml").write_text("go2w:\n  dt: 0.005\n  decimation: 8\n")
    assert PolicyController(inner).description.period == pytest.approx(0.04)


@needs_shared
def test_the_shipped_policy_drives_turns_and_holds() -> None:
    controller = PolicyController(POLICY)
    sim = Simulation(np.zeros((81, 81), np.float32), 0.1, (-4.0, -4.0))
    sim.reset(q=np.array([0, 0.5, -1.5] * 2 + [0, 0.8, -1.5] * 2 + [0.0] * 4))

    def run(seconds: float, vx: float = 0.0, wz: float = 0.0) -> None:
        for _ in range(round(seconds / sim.timestep)):
            sim.apply(controller.step(sim.low_state(), VelocityCommand(0, vx, 0.0, wz), PostureCommand(0)))
            sim.step()

    run(1.0, vx=0.5)
    x = sim.position[0]
    run(2.0, vx=0.5)
    assert (sim.position[0] - x) / 2.0 == pytest.approx(0.49, abs=0.03)
    yaw = sim.yaw
    run(1.5, wz=1.0)
    assert sim.yaw - yaw == pytest.approx(1.5 * 0.89, abs=0.25)
    run(1.5)
    place = sim.position
    run(3.0)
    assert np.linalg.norm(sim.position - place) < 0.003
