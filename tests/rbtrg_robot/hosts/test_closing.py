"""A map of the run with its loops closed comes while the robot drives: the robot glides in `map`, its goal stays there,
and the elevation map becomes the one that came."""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest

from hal.rotation import wrap
from hal.scenes.files import save_scene
from mapping.elevation.exchange import MapPatch
from rbtrg_robot import msg
from rbtrg_robot import topics as t
from rbtrg_robot.cli.close import closed
from rbtrg_robot.config import load
from rbtrg_robot.hosts.lockstep import Lockstep
from rbtrg_robot.hosts.map_build import build
from rbtrg_robot.orders.heard import Heard as Told
from rbtrg_robot.orders.map import read
from rbtrg_robot.topics import Topic
from rbtrg_robot.wire.convert import MAP, cloud_msg, cloud_points, map_patch, patch_msg
from rbtrg_robot.wire.frames import GLIDE, MapFrame, Planar, laid
from rbtrg_robot.wire.messages import decode, header, time_msg
from tests.rbtrg_robot.hosts.test_initial_pose import planar
from tools.closing import ring

SHIFT = (0.16, -0.08)
"""Of the map that comes [m]: whole cells."""
LIFT = 0.06
"""Higher [m]: more than a scan may differ from the map."""


@dataclass
class Heard:
    """What the stack tells of frames and map."""

    stack: Lockstep
    offsets: list[tuple[float, Planar, Planar]] = field(default_factory=list)
    """When [s], offset of `odom` in `map`, place of the robot in `map`."""
    parts: list[MapPatch] = field(default_factory=list)
    cloud: np.ndarray = field(default_factory=lambda: np.empty((0, 3), np.float32))

    def __post_init__(self) -> None:
        self.stack.host.listen(self._note, {t.TF_STATIC, t.MAP_PARTS, t.MAP_CLOUD})

    def _note(self, topic: Topic, payload: bytes, now: int) -> None:
        if topic is t.TF_STATIC:
            frame = MapFrame()
            frame.take(decode(payload, msg.TFMessage))
            odom = self.stack.newest.get(t.ODOM)
            place = planar(odom) if odom is not None else (0.0, 0.0, 0.0)
            self.offsets.append((now / 1e9, frame.offset, laid(frame.offset, place)))
        elif topic is t.MAP_PARTS:
            self.parts.append(map_patch(decode(payload, msg.MapPart).map, 0))
        else:
            self.cloud = cloud_points(decode(payload, msg.PointCloud2)).copy()

    def whole(self) -> MapPatch:
        """The present map."""
        self.parts.clear()
        self.stack.host.inject(t.MAP_REQUEST, msg.MapRequest(action="parts"))
        self.stack.run(0.5)
        (patch,) = self.parts
        return patch

    def closed(self) -> msg.MapPrior:
        """The present map elsewhere, as a map of this run."""
        patch = self.whole()
        moved = replace(
            patch, origin=(patch.origin[0] + SHIFT[0], patch.origin[1] + SHIFT[1]), stamp=patch.stamp
        )
        for name in ("elevation", "upper_bound"):
            moved.layers[name] = moved.layers[name] + np.float32(LIFT)
        x, y, yaw = self.offsets[-1][1]
        return msg.MapPrior(
            header=header(self.stack.now, MAP),
            id="sha256:0123456789abcdef",
            map=[patch_msg(moved)],
            cloud=cloud_msg(patch.stamp, MAP, self.cloud + np.float32([*SHIFT, LIFT])),
            odom_in_map=np.array([x + SHIFT[0], y + SHIFT[1], yaw, LIFT]),
            until=time_msg(patch.stamp),
        )


def heights(patch: MapPatch) -> dict[tuple[int, int], float]:
    """Of the trusted cells, by row and column."""
    rows, cols = np.nonzero(patch.layers["trusted"] > 0)
    cells = zip((rows + patch.cell[0]).tolist(), (cols + patch.cell[1]).tolist(), strict=True)
    return dict(zip(cells, patch.layers["elevation"][rows, cols].tolist(), strict=True))


def alike(a: MapPatch, b: MapPatch) -> float:
    """Share of the cells that both trust on which they agree."""
    one, other = heights(a), heights(b)
    off = np.array([one[cell] - other[cell] for cell in one.keys() & other.keys()])
    assert len(off) > 5000
    return float((np.abs(off) < 0.05).mean())


def test_the_robot_glides_in_the_map_while_it_drives_and_its_goal_stays_where_it_is() -> None:
    with Lockstep(load(None, ["sim.lidar_step=8"], scene="yard")) as stack:
        heard, places = Heard(stack), stack.config.load_scene().goals
        stack.wait_ready()
        stack.send_goal(*places["b"][:2])
        stack.run_until(lambda: stack.newest[t.GOAL_STATUS].state == "reached", 60.0, "the first goal")
        prior = heard.closed()
        x, y, _ = places["home"]
        goal = stack.send_goal(x, y)
        stack.run(3.0)
        assert stack.newest[t.GOAL_STATUS].state == "moving"
        before, first = stack.newest[t.MAP_STATUS], len(heard.offsets) - 1
        stack.host.inject(t.MAP_PRIOR, prior)
        stack.run(1.0)
        assert stack.newest[t.MAP_STATUS].location == "closing"
        stack.run_until(lambda: stack.newest[t.MAP_STATUS].location == "located", 40.0, "the closed map")
        now = stack.newest[t.MAP_STATUS]
        assert (now.prior, now.epoch) == (prior.id, before.epoch)
        assert now.height_correction - before.height_correction == pytest.approx(LIFT, abs=0.02)
        glided = heard.offsets[first:]
        for (since, old, _), (then, new, _) in pairwise(glided[1:]):
            assert math.dist(old[:2], new[:2]) <= GLIDE[0] * (then - since) + 1e-6
        start, end = glided[0][1], glided[-1][1]
        assert end == pytest.approx((start[0] + SHIFT[0], start[1] + SHIFT[1], start[2]), abs=1e-9)
        assert glided[-1][0] - glided[1][0] > 0.8 * math.hypot(*SHIFT) / GLIDE[0]
        stack.run_until(lambda: stack.newest[t.GOAL_STATUS].state == "reached", 90.0, "the goal")
        told = [status for status in stack.statuses if status.id == goal]
        assert {status.state for status in told} <= {
            "accepted",
            "planning",
            "moving",
            "recovering",
            "reached",
        }
        stack.run(1.0)
        place = planar(stack.newest[t.TRUTH])
        assert math.dist(place[:2], (x - SHIFT[0], y - SHIFT[1])) < 0.3, (
            "the goal stays where it is in the map"
        )
        assert alike(heard.whole(), map_patch(prior.map[0], 0)) > 0.97

        # while it stands it is there at once, and the map with it
        prior = replace(heard.closed(), id="sha256:fedcba9876543210")
        stack.host.inject(t.MAP_PRIOR, prior)
        stack.run(1.0)
        assert stack.newest[t.MAP_STATUS].location == "located"
        assert heard.offsets[-1][1] == pytest.approx(prior.odom_in_map[:3], abs=1e-9)
        stack.run(1.0)
        assert alike(heard.whole(), map_patch(prior.map[0], 0)) > 0.97


@pytest.mark.campaign
def test_real_loops_close_on_the_way_to_a_goal(tmp_path: Path) -> None:
    """Round a block of 12 x 8 m and on, with a local map so small that odometry drifts."""
    scene, corners = ring((6.0, 4.0))
    save_scene(scene, tmp_path / "ring.npz")
    sets = ["sim.lidar_step=4", "odometry.max_range=5.0", "recorder.profile=full"]
    config = load(None, sets, scene=str(tmp_path / "ring.npz"))
    run, out = tmp_path / "run", tmp_path / "closed.npz"
    run.mkdir()
    with Lockstep.open_log(config, run / "run.mcap") as log, Lockstep(config, log) as stack:
        heard, told = Heard(stack), Told()
        stack.host.listen(
            lambda topic, payload, _: told.take(topic, decode(payload, topic.kind)), set(Told.hears)
        )
        stack.wait_ready()

        def off() -> float:
            """Of the robot in `map` [m]."""
            place = laid(heard.offsets[-1][1], planar(stack.newest[t.ODOM]))
            return math.dist(place[:2], planar(stack.newest[t.TRUTH])[:2])

        for x, y in corners[1:5]:
            stack.send_goal(x, y)
            stack.run_until(lambda: stack.newest[t.GOAL_STATUS].state == "reached", 120.0, f"{x}, {y}")
        stack.send_goal(*corners[5])
        stack.run(20.0)
        goal, before = stack.send_goal(*corners[6]), off()
        log.flush()
        built = build([run], out)  # the robot drives on meanwhile
        stack.run(4.0)
        assert stack.newest[t.GOAL_STATUS].state == "moving"
        then = told.odometry(built.stamp)
        assert then is not None
        first, epoch = len(heard.offsets) - 1, stack.newest[t.MAP_STATUS].epoch
        stack.host.inject(t.MAP_PRIOR, closed(built, read(out, config.elevation), *then))
        stack.run(0.5)
        stack.run_until(lambda: stack.newest[t.MAP_STATUS].location == "located", 60.0, "the closed map")
        glided = heard.offsets[first:]
        for (since, old, _), (now, new, _) in pairwise(glided[1:]):
            assert math.dist(old[:2], new[:2]) <= GLIDE[0] * (now - since) + 1e-6
            assert abs(wrap(new[2] - old[2])) <= GLIDE[1] * (now - since) + 1e-6
        after = off()
        print(len(built.record["closed"]), built.record["moved_m"], before, after, glided[0], glided[-1])
        assert len(built.record["closed"]) >= 2
        assert after < 0.5 * before
        stack.run_until(lambda: stack.newest[t.GOAL_STATUS].state == "reached", 60.0, "the goal")
        assert (stack.newest[t.GOAL_STATUS].id, stack.newest[t.MAP_STATUS].epoch) == (goal, epoch)
