"""A film of a run, drawn from its log: the simulated robot at its true poses. Nothing is drawn while it runs."""

from __future__ import annotations

import contextlib
from collections.abc import Callable
from pathlib import Path

import numpy as np

from hal.mujoco.view.render import Film, View
from hal.types import GroundTruth
from rbtrg_robot import topics as t
from rbtrg_robot.config import ConfigError, load, of_log
from rbtrg_robot.log.read import CONFIG, first_of, read_run
from rbtrg_robot.wire.convert import LayoutError, joint_sample, xyz, xyzw
from rbtrg_robot.wire.messages import MessageError, decode, stamp_of


def film(
    log: Path, out: Path, progress: Callable[[int, int], None] | None = None, view: View | None = None
) -> int:
    """Write FILE.mp4, one FILE.png of the end, or a folder of frames. Returns the number of poses.

    Raises LogError, RenderError, and ConfigError when the log is not of a simulated robot or holds nothing to draw.
    """
    config = load(base=of_log(first_of(log).attachments.get(CONFIG, b""))[0])
    if not config.simulated:
        raise ConfigError(f"{log} is not the log of a simulated robot: there is no scene to draw")
    made = Film(config.load_scene(), view=view, robot=config.facts)
    for entry in read_run(log):
        with contextlib.suppress(MessageError, LayoutError):  # what was recorded broken is not drawn
            if entry.topic == t.JOINTS.name:
                made.take([joint_sample(decode(entry.data, t.JOINTS.kind))])
            elif entry.topic == t.TRUTH.name:
                message = decode(entry.data, t.TRUTH.kind)
                pose = message.pose.pose
                truth = GroundTruth(
                    stamp_of(message), xyz(pose.position), xyzw(pose.orientation), np.zeros(3), np.zeros(3)
                )
                made.take([truth])
    if not len(made):
        raise ConfigError(f"{log} holds no true poses")
    if out.suffix == ".png":
        made.picture(out)
    else:
        made.write(out, progress)
    return len(made)
