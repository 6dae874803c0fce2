"""Locomotion controllers by their names."""

from __future__ import annotations

from pathlib import Path

from hal.locomotion.hybrid import HybridController
from hal.locomotion.policy import PolicyController
from hal.locomotion.vmc import VmcController, warm_up
from hal.lowlevel import Controller, Locomotion


def controller_of(name: Controller, policy: str | Path = "", period: float = 0.005) -> Locomotion:
    """A controller, its kernels compiled.

    policy: folder or file of the learnt policy, empty for the one that was fetched; the model-based controller has none.
    period: of the model-based controller alone [s]; a policy brings its own. Raises PolicyError, and ValueError for a bad period.
    """
    if name == "policy":
        return PolicyController(policy)
    warm_up()  # before the clock runs: compiling takes seconds
    return HybridController(policy) if name == "hybrid" else VmcController(period=period)
