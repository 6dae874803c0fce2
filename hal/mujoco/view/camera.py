"""The simulated robot's camera: rendered off-screen from the true pose, in a process beside the physics.

Software rendering (no GPU) of 320 x 240 takes about 30 ms of a core, so whoever wants frames asks for them.
"""

from __future__ import annotations

import mujoco
import numpy as np
from numpy.typing import NDArray
from PIL import Image

from hal.camera import CameraError, CameraFrame, MountedCamera, encode
from hal.mujoco.config import Obstacle
from hal.mujoco.model import build
from hal.mujoco.view.render import Canvas, RenderError
from hal.robots import Robot, describe
from hal.scenes import Scene
from hal.types import NS, Array

NEAR_CLIP = 0.02
"""[m] What is nearer than this to the lens, such as the head that it sits in, is not drawn."""
LEAST_CELL = 0.06
"""[m] The ground is drawn in cells of this size or more: with cells of 0.04 m the process takes 20 MB more,
with 0.02 m 130, and a picture three times as long."""


class RenderedCamera:
    """`hal.camera.CameraSource` on a scene. `follow` tells it where the robot is."""

    def __init__(
        self,
        camera: MountedCamera,
        scene: Scene,
        obstacles: tuple[Obstacle, ...] = (),
        start_time: int = 0,
        robot: Robot | None = None,
    ) -> None:
        """`start_time`: source clock [ns] from which the obstacles' times count; `robot`: None takes the default
        one."""
        robot = robot or describe()
        self._robot = robot.model()
        self.camera = camera
        self._scene, self._obstacles, self.start_time = scene, obstacles, start_time
        self._joints: Array = robot.pose
        self._pose: tuple[int, Array, Array] | None = None
        self._drawn = -1
        self._canvas: Canvas | None = None

    def joints(self, position: Array) -> None:
        """(16,) [rad], SDK order."""
        self._joints = position

    def follow(self, stamp: int, position: Array, orientation: Array) -> None:
        """True pose at `stamp` [ns]: position (3,) [m], orientation x, y, z, w."""
        self._pose = stamp, position, orientation

    def open(self) -> str:
        """Take an OpenGL context; says which. Raises CameraError."""
        scene = self._scene
        sizes = [obstacle.size for obstacle in self._obstacles]
        model = build(*coarse_ground(scene), self._robot, boxes=sizes, camera=self.camera)
        model.vis.map.znear = NEAR_CLIP / model.stat.extent
        # Buffers for large pictures, soft edges and shadows take 300 MB, and most of the time.
        model.vis.global_.offwidth, model.vis.global_.offheight = self.camera.width, self.camera.height
        model.vis.quality.offsamples = model.vis.quality.shadowsize = 0
        canvas = Canvas(model, self.camera.width, self.camera.height, shadows=False)
        try:
            self._canvas = canvas.__enter__()
        except RenderError as error:
            raise CameraError(str(error)) from error
        canvas.camera.type = mujoco.mjtCamera.mjCAMERA_FIXED
        canvas.camera.fixedcamid = model.camera(self.camera.name).id
        return f"drawn with {canvas.renderer}, {self.camera.width} x {self.camera.height}"

    def frame(self, now: int) -> CameraFrame | None:
        """What the camera sees from the newest pose."""
        if self._canvas is None or self._pose is None or self._pose[0] == self._drawn:
            return None
        stamp, position, orientation = self._pose
        x, y, z, w = orientation
        pose = np.concatenate([position, [w, x, y, z], self._joints]).astype(np.float32)
        self._canvas.place(pose, self._obstacles, (stamp - self.start_time) / NS)
        picture = encode(Image.fromarray(self._canvas.draw()))
        self._drawn = stamp
        return CameraFrame(stamp, picture)

    def close(self) -> None:
        """Give the OpenGL context back."""
        if self._canvas is not None:
            self._canvas.__exit__()
            self._canvas = None


def coarse_ground(scene: Scene) -> tuple[NDArray[np.float32], float, tuple[float, float]]:
    """Ground of a scene for pictures: heights (rows, cols) [m], cell size [m], centre of cell [0, 0] (x, y) [m]. Each
    cell is as high as the highest that it replaces, so that thin walls and posts stay."""
    count = max(1, round(LEAST_CELL / scene.resolution))
    rows, cols = (-(-size // count) for size in scene.height.shape)
    if min(rows, cols) < 2:
        return scene.height, scene.resolution, scene.origin
    missing = rows * count - scene.height.shape[0], cols * count - scene.height.shape[1]
    padded = np.pad(scene.height, ((0, missing[0]), (0, missing[1])), mode="edge")
    highest = padded.reshape(rows, count, cols, count).max(axis=(1, 3))
    shift = 0.5 * (count - 1) * scene.resolution
    return highest, count * scene.resolution, (scene.origin[0] + shift, scene.origin[1] + shift)
