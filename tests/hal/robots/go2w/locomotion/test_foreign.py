"""Policies of others: three public layouts with random networks, recurrent ones, and files that must be refused."""

from __future__ import annotations

import contextlib
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from hypothesis import given, settings
from hypothesis import strategies as st
from typer.testing import CliRunner

pytest.importorskip("onnxruntime", reason="the extra `policies` is not installed")
from hal.limbs import MOTORS
from hal.lowlevel import Ground, LowState
from hal.robots.go2w import facts as go2w
from hal.robots.go2w.locomotion.controllers import check
from hal.robots.go2w.locomotion.description import Description
from hal.robots.go2w.locomotion.onnxfile import OnnxNetwork
from hal.robots.go2w.locomotion.policy import PolicyController
from hal.robots.go2w.locomotion.source import read_policy
from hal.robots.go2w.locomotion.torchfile import PolicyError
from hal.rotation import up_of
from hal.types import PostureCommand, VelocityCommand
from rbtrg_robot.cli.main import app
from tests.hal.robots.go2w.locomotion.networks import counting, linear, spoiled

LEGS = np.arange(12)
SWAPPED = [3, 4, 5, 0, 1, 2, 9, 10, 11, 6, 7, 8]
"""Left before right, as simulators have it: the SDK's motor of each joint of the policy."""
BY_KIND = [3, 0, 9, 6, 4, 1, 10, 7, 5, 2, 11, 8]
"""All hips, all thighs, all calves: Isaac's order."""


def states(n: int) -> list[LowState]:
    rng = np.random.default_rng(5)
    found = []
    for k in range(n):
        quaternion = np.array([1.0, *rng.normal(0.0, 0.1, 3)])
        found.append(
            LowState(0.02 * k, go2w.STAND + rng.normal(0.0, 0.1, 16), rng.normal(0.0, 1.0, 16), np.zeros(16),
                     quaternion / np.linalg.norm(quaternion), rng.normal(0.0, 0.5, 3), np.array([0.0, 0.0, 9.81]))
        )  # fmt: skip
    return found


def driven(controller: PolicyController, told: LowState, velocity: VelocityCommand) -> Any:
    """One run of the network: as many motor periods as it takes."""
    for _ in range(round(controller.description.period / controller.period)):
        command = controller.step(told, velocity, PostureCommand(0))
    return command


# --- three public layouts ----------------------------------------------------------------------------------------


def test_rl_sars_layout_with_history_and_the_left_legs_first(tmp_path: Path) -> None:
    """As its policy/go2/himloco: twelve joints, six steps, newest first, a command that is scaled unequally."""
    stand = [0.1, 0.8, -1.5, -0.1, 0.8, -1.5, 0.1, 1.0, -1.5, -0.1, 1.0, -1.5]
    config = {
        "model_name": "himloco.onnx", "num_observations": 45,
        "observations": ["commands", "ang_vel", "gravity_vec", "dof_pos", "dof_vel", "actions"],
        "observations_history": [0, 1, 2, 3, 4, 5], "observations_history_priority": "time",
        "clip_actions_lower": [-100] * 12, "clip_actions_upper": [100] * 12,
        "rl_kp": [40] * 12, "rl_kd": [1] * 12, "action_scale": [0.125, 0.25, 0.25] * 4, "wheel_indices": [],
        "commands_scale": [2.0, 2.0, 0.25], "default_dof_pos": stand, "joint_mapping": SWAPPED,
    }  # fmt: skip
    (tmp_path / "config.yaml").write_text(yaml.safe_dump({"go2/himloco": config}))
    weight = linear(tmp_path / "himloco.onnx", 270, 12)
    controller = PolicyController(tmp_path)
    assert controller.period == pytest.approx(0.005)
    frames: list[np.ndarray] = []
    action = np.zeros(12)
    for state in states(8):
        command = driven(controller, state, VelocityCommand(0, 0.5, 0.1, -0.3))
        up = up_of(state.quaternion)
        frame = np.concatenate(
            [
                np.array([0.5, 0.1, -0.3]) * [2.0, 2.0, 0.25], 0.25 * state.gyro, -np.array(up),
                state.q[SWAPPED] - stand, 0.05 * state.dq[SWAPPED], action,
            ]
        )  # fmt: skip
        frames = [frame, *(frames or [frame] * 5)][:6]
        action = np.clip(np.concatenate(frames) @ weight, -100, 100)
        np.testing.assert_allclose(command.q[SWAPPED], stand + action * ([0.125, 0.25, 0.25] * 4), atol=1e-5)
        np.testing.assert_array_equal(command.kp[:12], 40.0)
        assert (command.kd[12:] > 1.0).all(), "wheels that it does not know are braked"
        assert not command.kp[12:].any()
        assert not command.dq.any()


def deployed(n: int = 12, **changes: Any) -> dict[str, Any]:
    """A deploy.yaml as unitree_rl_lab's exporter writes it."""
    stiffness = [20.0 + motor for motor in range(n)]
    return {
        "joint_ids_map": BY_KIND, "step_dt": 0.02, "stiffness": stiffness, "damping": [0.5] * n,
        "default_joint_pos": [0.1, -0.1, 0.1, -0.1, 0.8, 0.8, 1.0, 1.0, -1.5, -1.5, -1.5, -1.5],
        "commands": {"base_velocity": {"ranges": {
            "lin_vel_x": [-0.5, 0.4], "lin_vel_y": [-0.3, 0.3], "ang_vel_z": [-0.2, 0.2], "heading": None,
        }}},
        "actions": {"JointPositionAction": {
            "clip": [[-1.0, 1.0]] * 12, "joint_names": [".*"], "scale": [0.25] * 12, "offset": [0.05] * 12,
            "joint_ids": None,
        }},
        "observations": {
            "base_ang_vel": {"params": {}, "clip": [-1.0, 1.0], "scale": [0.2] * 3, "history_length": 3},
            "projected_gravity": {"params": {}, "clip": None, "scale": [1.0] * 3, "history_length": 3},
            "velocity_commands": {
                "params": {"command_name": "base_velocity"}, "clip": None, "scale": [1.0] * 3, "history_length": 1,
            },
            "joint_pos_rel": {"params": {}, "clip": None, "scale": [1.0] * 12, "history_length": 3},
            "joint_vel_rel": {"params": {}, "clip": None, "scale": [0.05] * 12, "history_length": 3},
            "last_action": {"params": {}, "clip": None, "scale": [1.0] * 12, "history_length": 1},
        },
    } | changes  # fmt: skip


def test_unitree_rl_labs_layout_with_a_history_of_each_term(tmp_path: Path) -> None:
    text = yaml.safe_dump(deployed(), sort_keys=False).replace(
        "joint_ids: null", "joint_ids: !!python/object/apply:builtins.slice [null, null, null]"
    )
    (tmp_path / "params").mkdir()
    (tmp_path / "params" / "deploy.yaml").write_text(text)
    weight = linear(tmp_path / "exported" / "policy.onnx", 3 * (3 + 3 + 12 + 12) + 3 + 12, 12, batch="batch")
    controller = PolicyController(tmp_path)
    stand = np.array(deployed()["default_joint_pos"])
    past: dict[str, list[np.ndarray]] = {}
    action = np.zeros(12)
    for state in states(5):
        command = driven(controller, state, VelocityCommand(0, 0.9, -0.1, 1.0))
        terms = {
            "gyro": (np.clip(state.gyro, -1.0, 1.0) * 0.2, 3), "gravity": (-np.array(up_of(state.quaternion)), 3),
            "command": (np.array([0.4, -0.1, 0.2]), 1), "angles": (state.q[BY_KIND] - stand, 3),
            "speeds": (state.dq[BY_KIND] * 0.05, 3), "action": (action, 1),
        }  # fmt: skip
        seen = []
        for name, (now, length) in terms.items():
            past[name] = [*past.get(name, [now] * length), now][-length:]
            seen += past[name]
        action = np.concatenate(seen) @ weight
        wanted = np.clip(0.25 * action + 0.05, -1.0, 1.0)
        np.testing.assert_allclose(command.q[BY_KIND], wanted, atol=1e-5)
        np.testing.assert_array_equal(command.kp[:12], 20.0 + LEGS)


OWN: dict[str, Any] = {
    "network": "net.onnx", "period": 0.02, "stand": [0.0, 0.7, -1.4] * 4 + [0.0] * 4, "kp": 30.0, "kd": 0.7,
    "joints": [f"{leg}_{part}" for leg in ("FL", "FR", "RL", "RR") for part in ("hip", "thigh", "calf", "wheel")],
    "action": {"scale": [0.2, 0.2, 0.2, 5.0] * 4, "clip": [-2.0, 2.0]},
    "history": {"ages": [4, 0], "order": "term"},
    "observation": [
        {"term": "angles"}, {"term": "gyro", "scale": 0.5, "clip": [-0.3, 0.3]}, {"term": "command", "ages": [0]},
        {"term": "action"}, {"term": "gravity"}, {"term": "speeds", "scale": 0.1},
    ],
}  # fmt: skip
OWN["stand"] = [0.0, 0.7, -1.4, 0.0] * 4


def own(folder: Path, size: int = 2 * (16 + 3 + 16 + 3 + 16) + 3, **changes: Any) -> Path:
    (folder / "policy.yaml").write_text(yaml.safe_dump(OWN | changes))
    linear(folder / "net.onnx", size)
    return folder


def test_a_description_of_ours_with_wheels_amid_the_legs(tmp_path: Path) -> None:
    controller = PolicyController(own(tmp_path) / "policy.yaml")
    order = [MOTORS.index(name) for name in OWN["joints"]]
    weight = linear(tmp_path / "net.onnx", 111)
    past: list[dict[str, np.ndarray]] = []
    action = np.zeros(16)
    wheels = np.arange(3, 16, 4)
    for state in states(7):
        command = driven(controller, state, VelocityCommand(0, 0.5))
        angles = state.q[order] - OWN["stand"]
        angles[wheels] = 0.0
        now = {
            "angles": angles, "gyro": np.clip(state.gyro, -0.3, 0.3) * 0.5, "action": action,
            "gravity": -np.array(up_of(state.quaternion)), "speeds": state.dq[order] * 0.1,
        }  # fmt: skip
        past = [now, *(past or [now] * 4)][:5]
        both = {name: np.concatenate([past[4][name], past[0][name]]) for name in now}
        both["command"] = np.array([0.5, 0.0, 0.0])
        seen = np.concatenate([both[term["term"]] for term in OWN["observation"]])
        action = np.clip(seen @ weight, -2.0, 2.0)
        legs = np.setdiff1d(np.arange(16), wheels)
        wanted = np.array(OWN["stand"]) + 0.2 * action
        np.testing.assert_allclose(command.q[order][legs], wanted[legs], atol=1e-5)
        np.testing.assert_allclose(command.dq[order][wheels], 5.0 * action[wheels], atol=1e-4)


def test_heights_are_seen_in_rows_from_the_right_below_an_offset(tmp_path: Path) -> None:
    seen = [
        {
            "term": "heights",
            "x": [-0.2, 0.2, 3],
            "y": [-0.1, 0.1, 2],
            "offset": 0.3,
            "unknown": 0.32,
            "clip": [-0.1, 0.1],
            "scale": 5.0,
        }
    ]
    controller = PolicyController(own(tmp_path, 6, history={}, observation=seen))
    wanted = [[-0.2, -0.1], [0.0, -0.1], [0.2, -0.1], [-0.2, 0.1], [0.0, 0.1], [0.2, 0.1]]
    np.testing.assert_allclose(controller.layout.places, wanted, atol=1e-9)
    state, told = states(1)[0], VelocityCommand(0, 0.3)
    weight = linear(tmp_path / "net.onnx", 6)

    def thigh() -> float:
        controller.reset()
        return float(controller.step(state, told, PostureCommand(0)).q[MOTORS.index("FL_thigh")])

    # Nobody tells it any, then all, then half of them: what is not known counts as it declares, and it says so.
    assert thigh() == pytest.approx(0.7 + 0.2 * float(np.full(6, 0.1) @ weight[:, 1]), abs=1e-5)
    assert "nobody tells it any; it counts as 0.32 m" in controller.warning()
    controller.see(Ground(np.array([0.3, 0.35, 0.6, 0.25, 0.0, 0.38]), ""))
    heights = np.array([0.0, 0.25, 0.5, -0.25, -0.5, 0.4])
    assert thigh() == pytest.approx(0.7 + 0.2 * float(heights @ weight[:, 1]), abs=1e-5)
    assert controller.warning() == ""
    controller.see(Ground(np.array([0.3, 0.35, 0.6, np.nan, np.nan, np.nan]), ""))
    assert thigh() == pytest.approx(
        0.7 + 0.2 * float(np.array([*heights[:3], 0.1, 0.1, 0.1]) @ weight[:, 1]), abs=1e-5
    )
    check("policy", str(tmp_path))
    with pytest.raises(PolicyError, match="sees heights of the ground at 6 places, which do not reach"):
        check("policy", str(tmp_path), blind=True)


# --- memory ------------------------------------------------------------------------------------------------------


def test_a_recurrent_network_remembers_until_it_is_reset(tmp_path: Path) -> None:
    counting(tmp_path / "net.onnx", 3)
    (tmp_path / "policy.yaml").write_text(
        yaml.safe_dump(OWN | {"history": {}, "observation": [{"term": "command"}]})
    )
    controller = PolicyController(tmp_path)
    assert controller.network.remembers == 1
    state = states(1)[0]
    first = [driven(controller, state, VelocityCommand(0, 0.25)).q[0] for _ in range(3)]
    np.testing.assert_allclose(first, [0.05, 0.1, 0.15], atol=1e-6)
    controller.reset()
    assert driven(controller, state, VelocityCommand(0, 0.25)).q[0] == pytest.approx(0.05)


# --- what is refused ---------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("how", "words"),
    [
        ("operator", "the operator com.evil.Custom is not one of those a policy needs"),
        ("loop", "the operator Loop is not one"),
        ("elsewhere", "its numbers lie in another file"),
        ("bomb", "is 1600000 numbers: export it with fixed shapes"),
        ("unknown", "is not known before it runs|does not hold together"),
        ("inputs", "there is one for the observation"),
        ("state", "h_in needs an output h_out of the same shape"),
        ("doubles", "obs is not of 32 bit floats"),
    ],
)
def test_a_network_that_must_not_be_run_is_refused(tmp_path: Path, how: str, words: str) -> None:
    spoiled(tmp_path / "p.onnx", how)
    with pytest.raises(PolicyError, match=words) as error:
        OnnxNetwork(tmp_path / "p.onnx")
    assert "\n" not in str(error.value)


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"observation": [{"term": "lin_vel"}]}, "no sensor at the motors measures the speed"),
        ({"observation": [{"term": "smell"}]}, "unknown term 'smell': there is gyro"),
        ({"observation": [{"term": "heights"}]}, "need x and y"),
        ({"observation": [{"term": "heights", "x": [0, 1, 2], "y": [0, 1, 2]}]}, "and unknown"),
        ({"observation": [{"term": "gyro"}, {"term": "gyro"}]}, "each term once"),
        ({"observation": [{"term": "gyro", "scale": [1.0, 2.0]}]}, "gyro.scale must be one number or 3"),
        ({"observation": [{"term": "gyro", "clip": [1.0, -1.0]}]}, "above the upper one"),
        (
            {"observation": [{"term": "heights", "x": [0, 1, 2000], "y": [0, 1, 1000], "unknown": 0.5}]},
            "2000 x 1000 places",
        ),
        ({"history": {"ages": [0, 0]}}, "each once"),
        ({"history": {"order": "frame"}, "observation": [{"term": "gyro", "ages": [1]}]}, "need `order: term`"),
        ({"joints": list(MOTORS[3:])}, "FR_hip, FR_thigh, FR_calf would hang free"),
        ({"joints": [*MOTORS[:15], "tail"]}, "tail; there are FR_hip"),
        ({"stand": [0.0] * 12}, "stand must hold 16 numbers"),
        ({"kp": -1.0}, "not negative"),
        ({"period": 5.0}, "period"),
        ({"sees": 1}, "sees: Extra inputs are not permitted"),
        ({"network": "/etc/passwd"}, "must lie in the same folder"),
        ({"network": "none.onnx"}, "does not exist"),
        ({"network": "policy.yaml"}, "an .onnx file or a TorchScript .pt"),
        ({}, "maps 50 to 16 numbers, this policy should map 111 to 16"),
    ],
)  # fmt: skip
def test_a_description_that_does_not_fit_says_why(
    tmp_path: Path, changes: dict[str, Any], words: str
) -> None:
    with pytest.raises(PolicyError, match=words) as error:
        read_policy(own(tmp_path, 50, **changes))
    assert "\n" not in str(error.value)
    assert str(tmp_path) in str(error.value)


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"joint_ids_map": list(range(16))}, "stiffness and damping must hold"),
        ({"joint_ids_map": [99] * 12}, "joint_ids_map"),
        ({"actions": {"JointEffortAction": {"scale": [1.0], "offset": [0.0]}}}, "JointEffortAction is not known"),
        ({"actions": {"JointVelocityAction": {"scale": [1.0] * 12, "offset": [0.0] * 12}}}, "wheels speeds"),
        ({"actions": {"JointPositionAction": {"scale": [1.0] * 3, "offset": [0.0] * 3}}}, "must hold 12 numbers"),
        ({"observations": {"height_scan": {"scale": [1.0]}}}, "term: heights"),
        ({"observations": {"gait_phase": {"scale": [1.0]}}}, "unknown term 'gait_phase'"),
        ({"commands": {}}, "lin_vel_x"),
    ],
)  # fmt: skip
def test_a_deployment_that_does_not_fit_says_why(tmp_path: Path, changes: dict[str, Any], words: str) -> None:
    (tmp_path / "deploy.yaml").write_text(yaml.safe_dump(deployed(**changes), sort_keys=False))
    linear(tmp_path / "policy.onnx", 57)
    with pytest.raises(PolicyError, match=words) as error:
        read_policy(tmp_path)
    assert "\n" not in str(error.value)


def test_a_network_alone_does_not_say_what_it_sees(tmp_path: Path) -> None:
    linear(tmp_path / "p.onnx", 57)
    with pytest.raises(PolicyError, match="does not say what it sees"):
        read_policy(tmp_path / "p.onnx")


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("a: &x [1, 2]\nb: &y [*x, *x]\nc: [*y, *y]\n", "alias"),
        ("a: !!python/object/apply:os.system ['true']\n", "python/object"),
        ("[1, 2]", "must hold `key: value` lines"),
        ("a: " + "[" * 600, "cannot be read"),
        ("a: " + "x" * 300_000, "more than 200 kB"),
    ],
)
def test_a_description_that_attacks_its_reader_is_refused(tmp_path: Path, text: str, words: str) -> None:
    (tmp_path / "policy.yaml").write_text(text)
    with pytest.raises(PolicyError, match=words):
        read_policy(tmp_path)


@settings(max_examples=60, deadline=None)
@given(data=st.data())
def test_a_damaged_network_is_read_or_refused(
    data: st.DataObject, tmp_path_factory: pytest.TempPathFactory
) -> None:
    path = tmp_path_factory.mktemp("damaged") / "p.onnx"
    counting(path, 5)
    whole = bytearray(path.read_bytes())
    for _ in range(data.draw(st.integers(1, 4))):
        whole[data.draw(st.integers(0, len(whole) - 1))] = data.draw(st.integers(0, 255))
    path.write_bytes(whole[: data.draw(st.integers(1, len(whole)))])
    with contextlib.suppress(PolicyError):
        OnnxNetwork(path)(np.zeros(5, np.float32))


VALUES = st.recursive(
    st.none() | st.booleans() | st.integers(-5, 200) | st.floats() | st.text(max_size=6),
    lambda inner: st.lists(inner, max_size=4)
    | st.dictionaries(st.sampled_from(["term", "scale", "clip", "x", "ages"]), inner, max_size=3),
    max_leaves=8,
)  # fmt: skip


@settings(max_examples=60, deadline=None)
@given(key=st.sampled_from([*OWN, "motor_period"]), value=VALUES)
def test_a_description_of_anything_is_read_or_refused(
    key: str, value: Any, tmp_path_factory: pytest.TempPathFactory
) -> None:
    folder = tmp_path_factory.mktemp("any")
    (folder / "policy.yaml").write_text(yaml.safe_dump(OWN | {key: value}))
    with contextlib.suppress(PolicyError):
        read_policy(folder)


def test_a_description_knows_how_much_it_sees() -> None:
    described = Description.model_validate(OWN)
    assert described.seen == 111
    assert described.every == 4


# --- the command -------------------------------------------------------------------------------------------------


def test_the_check_says_what_a_policy_needs_and_that_a_random_one_does_not_drive(tmp_path: Path) -> None:
    run = CliRunner().invoke(app, ["policy", "check", str(own(tmp_path))])
    assert run.exit_code == 1
    for words in (
        "a description of ours", "111 numbers in, 16 out", "every 20 ms",
        "sees gyro: 3 numbers, of 2 steps (ages 4, 0)",
        "moves 16 joints", "it first moves", "Nm", "wrong: policy: told 0.4 m/s",
    ):  # fmt: skip
        assert words in run.output, words


def test_the_check_of_a_policy_that_cannot_be_read_is_one_line(tmp_path: Path) -> None:
    run = CliRunner().invoke(app, ["policy", "check", str(tmp_path)])
    assert run.exit_code == 1
    assert isinstance(run.exception, PolicyError | SystemExit)
