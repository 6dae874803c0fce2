"""The simulated robot's camera: rendered off-screen from the true pose, in a process beside the physics.

Software rendering (no GPU) of 320 x 240 takes about 15 ms of a core, so whoever wants frames asks for them.
"""

from __future__ import annotations

import mujoco
import numpy as np
from numpy.typing import NDArray
from PIL import Image

from hal.camera import CameraError, CameraFrame, MountedCamera, encode
from hal.mujoco.config import Obstacle
from hal.mujoco.model import build, lay_ground
from hal.mujoco.view.render import Canvas, RenderError
from hal.robots import Robot, describe
from hal.scenes import Scene
from hal.types import NS, Array

NEAR_CLIP = 0.02
"""[m] What is nearer than this to the lens, such as the head that it sits in, is not drawn."""
LEAST_CELL = 0.1
"""[m] The ground is drawn in cells of this size or more: it takes most of the time of a picture."""
DRAWN_SIDE = 20.0
"""[m] Side of the square of ground around the robot that is drawn: a large site costs no more than a small one."""
KEPT_SHARE = 0.1
"""Of that side, by which the robot leaves the middle before the square comes after it."""


Ground = tuple[NDArray[np.float32], float, tuple[float, float]]
"""Heights (rows, cols) [m], cell size [m], centre of cell [0, 0] (x, y) [m]."""


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
        self._obstacles, self.start_time = obstacles, start_time
        self._height, self._cell, self._origin = coarse_ground(scene)
        self._middle = scene.start[:2]
        """[m] Of the drawn ground."""
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
        sizes = [obstacle.size for obstacle in self._obstacles]
        model = build(*self._near(), self._robot, boxes=sizes, camera=self.camera)
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
        if max(abs(position[:2] - self._middle)) > KEPT_SHARE * DRAWN_SIDE:
            self._middle = float(position[0]), float(position[1])
            lay_ground(self._canvas.model, *self._near())
            self._canvas.take_ground()
        x, y, z, w = orientation
        pose = np.concatenate([position, [w, x, y, z], self._joints]).astype(np.float32)
        self._canvas.place(pose, self._obstacles, (stamp - self.start_time) / NS)
        picture = encode(Image.fromarray(self._canvas.draw()))
        self._drawn = stamp
        return CameraFrame(stamp, picture)

    def _near(self) -> Ground:
        """Of the ground, the square around the middle; as large on the border of the site."""
        count = round(DRAWN_SIDE / self._cell)
        row, col = (
            int(np.clip(round((at - begin) / self._cell - 0.5 * count), 0, max(0, size - count)))
            for at, begin, size in zip(
                self._middle[::-1], self._origin[::-1], self._height.shape, strict=True
            )
        )
        origin = self._origin[0] + col * self._cell, self._origin[1] + row * self._cell
        return self._height[row : row + count, col : col + count], self._cell, origin

    def close(self) -> None:
        """Give the OpenGL context back."""
        if self._canvas is not None:
            self._canvas.__exit__()
            self._canvas = None


def coarse_ground(scene: Scene) -> Ground:
    """Ground of a scene for pictures. Each cell is as high as the highest that it replaces, so that thin walls and
    posts stay."""
    count = max(1, round(LEAST_CELL / scene.resolution))
    rows, cols = (-(-size // count) for size in scene.height.shape)
    if min(rows, cols) < 2:
        return scene.height, scene.resolution, scene.origin
    missing = rows * count - scene.height.shape[0], cols * count - scene.height.shape[1]
    padded = np.pad(scene.height, ((0, missing[0]), (0, missing[1])), mode="edge")
    highest = padded.reshape(rows, count, cols, count).max(axis=(1, 3))
    shift = 0.5 * (count - 1) * scene.resolution
    return highest, count * scene.resolution, (scene.origin[0] + shift, scene.origin[1] + shift)
