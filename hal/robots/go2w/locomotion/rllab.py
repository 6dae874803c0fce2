"""Policies in unitree_rl_lab's layout: `params/deploy.yaml` and `exported/policy.onnx`, as its exporter writes them."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

from pydantic import BaseModel, ConfigDict, Field, ValidationError

from hal.limbs import MOTORS
from hal.robots.go2w.locomotion.description import Action, Description, History, Term
from hal.robots.go2w.locomotion.torchfile import PolicyError
from hal.robots.go2w.locomotion.yamlfile import first_error, read_yaml

Values = Annotated[tuple[float, ...], Field(max_length=64)]
Joints = Annotated[tuple[Annotated[int, Field(ge=0, lt=len(MOTORS))], ...], Field(max_length=len(MOTORS))]
_LOOSE = ConfigDict(frozen=True, extra="ignore", allow_inf_nan=False)
_TERMS = {
    "base_ang_vel": "gyro",
    "projected_gravity": "gravity",
    "velocity_commands": "command",
    "joint_pos_rel": "angles",
    "joint_pos_rel_without_wheel": "angles",
    "joint_vel_rel": "speeds",
    "last_action": "action",
}
WHEELED = "joint_pos_rel counts the turns of the wheels: train with joint_pos_rel_without_wheel"
SCANNED = "says no places of height_scan: describe this policy in a policy.yaml with `term: heights`"


class _Observed(BaseModel):
    model_config = _LOOSE

    scale: Values
    clip: tuple[float, float] | None = None
    history_length: int = Field(1, ge=1, le=100)


class _Acted(BaseModel):
    model_config = _LOOSE

    scale: Values
    offset: Values
    clip: tuple[tuple[float, float], ...] | None = None
    joint_ids: Joints | None = None


class _Ranges(BaseModel):
    model_config = _LOOSE

    lin_vel_x: tuple[float, float]
    lin_vel_y: tuple[float, float]
    ang_vel_z: tuple[float, float]


class Deployed(BaseModel):
    """What deploy.yaml says. Stiffness and damping stand in the order of motors, all else in that of the policy."""

    model_config = _LOOSE

    joint_ids_map: Joints
    step_dt: float = Field(gt=0.0, le=0.2)
    stiffness: Values
    damping: Values
    default_joint_pos: Values
    commands: dict[str, dict[str, Any]]
    actions: dict[str, _Acted]
    observations: dict[str, _Observed]

    def described(self) -> Description:
        """The same in our own words. Raises ValueError, of which pydantic's ValidationError is one."""
        motors, n = self.joint_ids_map, len(self.joint_ids_map)
        if min(len(self.stiffness), len(self.damping)) <= max(motors, default=0):
            raise ValueError("stiffness and damping must hold one number per motor")
        ranges = _Ranges.model_validate(self.commands.get("base_velocity", {}).get("ranges", {}))
        asked = (ranges.lin_vel_x, ranges.lin_vel_y, ranges.ang_vel_z)
        return Description(
            network="policy.onnx",
            period=self.step_dt,
            joints=tuple(MOTORS[motor] for motor in motors),
            stand=self.default_joint_pos,
            kp=tuple(self.stiffness[motor] for motor in motors),
            kd=tuple(self.damping[motor] for motor in motors),
            action=self._action(n),
            history=History(order="term"),
            observation=tuple(self._term(name, term, asked) for name, term in self.observations.items()),
        )

    def _action(self, n: int) -> Action:
        """All outputs, which positions and velocities share among them, one group after the other."""
        known = ("JointPositionAction", "JointVelocityAction")
        if unknown := [name for name in self.actions if name not in known]:
            raise ValueError(f"actions: {', '.join(unknown)} is not known: there is {', '.join(known)}")
        scale: list[float] = []
        offset: list[float] = []
        clip: list[tuple[float, float]] = []
        at: list[int] = []
        for name, group in self.actions.items():
            joints = tuple(range(n)) if group.joint_ids is None else group.joint_ids
            wheels = [motor >= 12 for motor in (self.joint_ids_map[k] for k in joints if k < n)]
            if any(wheel != name.startswith("JointVelocity") for wheel in wheels):
                raise ValueError(f"actions: {name}: legs follow angles, wheels speeds")
            if {len(group.scale), len(group.offset), len(group.clip or joints)} != {len(joints)}:
                raise ValueError(f"actions: {name}: scale, offset and clip must hold {len(joints)} numbers")
            at += joints
            scale += group.scale
            offset += group.offset
            clip += group.clip or [(-1e6, 1e6)] * len(joints)
        if at != list(range(n)):
            raise ValueError("actions: the outputs must stand in the order of the joints, each once")
        low, high = zip(*clip, strict=True)
        return Action(scale=tuple(scale), offset=tuple(offset), clip=(-1e6, 1e6), targets=(low, high))

    def _term(self, name: str, term: _Observed, asked: tuple[tuple[float, float], ...]) -> Term:
        if name.startswith("height_scan"):
            raise ValueError(f"observations: deploy.yaml {SCANNED}")
        if name == "joint_pos_rel" and any(motor >= 12 for motor in self.joint_ids_map):
            raise ValueError(f"observations: {WHEELED}")
        clip: Any = term.clip
        if name == "velocity_commands":
            low, high = zip(*asked, strict=True)
            clip = (low, high)
        ages = tuple(reversed(range(term.history_length)))
        return Term(term=_TERMS.get(name, name), scale=term.scale, clip=clip, ages=ages)


def load_deployed(file: Path) -> Description:
    """A deploy.yaml. Raises PolicyError."""
    tree = read_yaml(file)
    try:
        return Deployed.model_validate(tree).described()
    except ValidationError as error:
        raise PolicyError(f"{file}: {first_error(error)}") from error
    except ValueError as error:
        raise PolicyError(f"{file}: {error}") from error
