"""Locomotion controllers by their names."""

from __future__ import annotations

from pathlib import Path

from hal.lowlevel import Locomotion
from hal.robots.go2w.locomotion.hybrid import HybridController
from hal.robots.go2w.locomotion.policy import PolicyController
from hal.robots.go2w.locomotion.public import DEFAULT, POLICIES, stored
from hal.robots.go2w.locomotion.torchfile import PolicyError
from hal.robots.go2w.locomotion.vmc import VmcController, warm_up

OURS = Path(__file__).with_name("go2w.npz")
"""The policy that `tools.train` made and the hybrid controller climbs with."""


def policy_of(name: str, source: str | Path = "") -> Path:
    """Folder or file of a controller's learnt policy.

    source: a path, or the name of a policy that was fetched. Empty: ours for the hybrid controller; for the policy
    alone the public one, since ours was trained to climb for the hybrid controller. Raises PolicyError."""
    if not str(source):
        return OURS if name == "hybrid" else stored(DEFAULT)
    if str(source) in POLICIES and not Path(source).exists():
        return stored(str(source))
    return Path(source)


def controller_of(name: str, policy: str | Path = "", period: float = 0.005) -> Locomotion:
    """A controller with compiled kernels.

    policy: of the learnt policy, see `policy_of`; the model-based controller has none. period: of the model-based
    controller alone [s]; a policy brings its own. Raises PolicyError, and ValueError for a bad period."""
    if name == "policy":
        return PolicyController(policy_of(name, policy))
    warm_up()  # before the clock runs: compiling takes seconds
    if name != "hybrid":
        return VmcController(period=period)
    return HybridController(policy_of(name, policy))


def check(name: str, policy: str = "", blind: bool = False) -> None:
    """Whether a controller has what it needs. `blind`: the map does not reach it. Raises PolicyError."""
    if name == "vmc":
        return
    count = len(PolicyController(policy_of(name, policy)).places)
    if blind and count:
        raise PolicyError(
            f"the policy sees heights of the ground at {count} places, which do not reach the real robot's motors: "
            "use one that is blind"
        )
