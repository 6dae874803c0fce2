"""Makes the backend of a real robot, or says what is missing."""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import TYPE_CHECKING

from hal.contract import BackendError
from hal.optional import INSTALL_DDS

if TYPE_CHECKING:
    from hal.contract import Backend
    from hal.unitree.config import UnitreeConfig


class MissingExtra(BackendError):
    """The optional DDS package is not installed."""

    retry = False


def check(interface: str) -> None:
    """Whether a robot can be looked for on `interface`. Raises MissingExtra, BackendError."""
    try:
        import cyclonedds.core  # noqa: F401
    except ImportError as error:
        raise MissingExtra(
            f"the Unitree backend needs DDS ({error}); install it with: {INSTALL_DDS}"
        ) from error
    from hal.unitree.link import check_interface

    check_interface(interface)


def make_backend(
    interface: str,
    dry_run: bool = False,
    options: UnitreeConfig | None = None,
    clock: Callable[[], int] = time.time_ns,
    controller: str = "",
    policy: str = "",
) -> Backend:
    """Backend for the robot on `interface`; `clock` [ns] is that of the `now` it will be given.

    controller, policy: of level low, see `hal.robots.go2w.locomotion.controllers`. Raises MissingExtra,
    BackendError for an unusable interface, or PolicyError."""
    check(interface)
    from hal.unitree.config import UnitreeConfig

    options = options or UnitreeConfig()
    domain = options.dds_domain(interface)
    if options.level == "low":
        if options.robot.name != "go2w":
            raise BackendError(
                f"our controllers drive the motors of a Go2-W alone: unitree.level=sport for {options.robot.title}",
                retry=False,
            )
        if dry_run:
            raise BackendError("a dry run listens to the sport service: unitree.level=sport", retry=False)
        from hal.robots.go2w.locomotion.controllers import check as check_controller
        from hal.unitree.low.backend import LowLevelBackend

        check_controller(controller, policy, blind=True)
        return LowLevelBackend(interface, domain, options, controller, policy, clock=clock)
    from hal.unitree.backend import UnitreeBackend

    return UnitreeBackend(interface, domain, options, dry_run, clock=clock)
