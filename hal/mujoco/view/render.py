"""Pictures and films of the simulated robot, off-screen, and an interactive viewer.

Software rendering costs 0.1 to 0.5 s per frame, far more than the simulation: so nothing is drawn while the robot
runs. A `Film` collects poses (from `read`, or from a log of true poses and joints) and draws them when asked."""

from __future__ import annotations

import ctypes.util
import os
import subprocess
import sys
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Self

import mujoco
import numpy as np
from numpy.typing import NDArray
from PIL import Image

from hal.errors import OperatorError
from hal.limbs import MOTORS
from hal.mujoco.config import Obstacle
from hal.mujoco.model import HIDDEN_PLACE, build
from hal.mujoco.obstacles import box_at, present
from hal.mujoco.view.video import Frame, write_mp4
from hal.robots import Robot, describe
from hal.scenes import Scene
from hal.types import NS, Array, GroundTruth, JointSample, Sample

HELP = "apt-get install libegl1 libgl1-mesa-dri, or libosmesa6 for rendering without EGL"


class RenderError(OperatorError):
    """Nothing can be drawn here; the message tells what to install or change."""


@dataclass(frozen=True, slots=True)
class View:
    """Looks of a film."""

    width: int = 854
    height: int = 480
    fps: int = 12
    distance: float = 2.8
    """[m] from the robot."""
    azimuth: float = 125.0
    """Heading of the camera's view [deg], world."""
    elevation: float = -36.0
    """[deg]"""
    follow: float = 0.6
    """Time constant [s] with which the camera follows the robot."""
    speed: float = 1.0
    """How many seconds of the run pass in one of the film."""


def egl_works() -> bool:
    """Whether EGL opens a context. Tried in another process: PyOpenGL cannot change to OSMesa once it has loaded
    EGL."""
    if ctypes.util.find_library("EGL") is None:
        return False
    probe = "from mujoco.egl import GLContext; GLContext(16, 16).make_current()"
    try:
        return (
            subprocess.run([sys.executable, "-c", probe], capture_output=True, timeout=30.0).returncode == 0
        )
    except subprocess.TimeoutExpired:
        return False


def gl_context(width: int, height: int) -> Any:
    """An off-screen OpenGL context, current: EGL, or OSMesa where EGL does not work. MUJOCO_GL=egl|osmesa decides
    alone."""
    wanted = os.environ.get("MUJOCO_GL", "").lower()
    if wanted not in ("egl", "osmesa"):
        wanted = "egl" if egl_works() else "osmesa"
    try:
        if wanted == "egl":
            from mujoco.egl import GLContext
        else:
            # PyOpenGL takes the platform from here when it is first imported.
            os.environ.setdefault("PYOPENGL_PLATFORM", "osmesa")
            from mujoco.osmesa import GLContext
        context = GLContext(width, height)
        context.make_current()
    except (ImportError, RuntimeError, AttributeError, OSError) as error:
        other = "osmesa" if wanted == "egl" else "egl"
        raise RenderError(
            f"cannot draw with {wanted} ({' '.join(str(error).split())}): {HELP}; then try MUJOCO_GL={other}"
        ) from error
    return context


class Film:
    """Poses of a robot in a scene, drawn on demand."""

    def __init__(
        self,
        scene: Scene,
        obstacles: tuple[Obstacle, ...] = (),
        view: View | None = None,
        robot: Robot | None = None,
    ) -> None:
        """robot: None takes the default one."""
        self.scene = scene
        self.robot = robot or describe()
        self.obstacles = obstacles
        self.view = view or View()
        self._joints = self.robot.pose
        self._start: int | None = None
        self._poses: list[tuple[float, NDArray[np.float32]]] = []

    def __len__(self) -> int:
        return len(self._poses)

    def take(self, samples: Iterable[Sample]) -> None:
        """Keep what the film needs of these: the newest joints and, at the frame rate, the true pose."""
        for sample in samples:
            if isinstance(sample, JointSample):
                self._joints = sample.position
            elif isinstance(sample, GroundTruth):
                self.add(sample.stamp, sample.position, sample.orientation, self._joints)

    def add(self, stamp: int, position: Array, orientation: Array, joints: Array) -> None:
        """One pose: `stamp` [ns], `position` (3,) [m], `orientation` x, y, z, w, `joints` (16,) [rad], SDK order.

        Poses that come faster than the film shows are left out.
        """
        if self._start is None:
            self._start = stamp
        time = (stamp - self._start) / NS
        if time + 1e-6 < len(self._poses) * self.view.speed / self.view.fps:
            return
        x, y, z, w = orientation
        self._poses.append((time, np.concatenate([position, [w, x, y, z], joints]).astype(np.float32)))

    def frames(self) -> Iterator[Frame]:
        """Draw all poses. Raises RenderError."""
        with _Studio(self.scene, self.obstacles, self.view, self.robot) as studio:
            for time, pose in self._poses:
                yield studio.shot(time, pose)

    def picture(self, path: Path) -> None:
        """The last pose as PNG. Raises RenderError."""
        if not self._poses:
            raise RenderError("nothing to draw: no pose was recorded")
        with _Studio(self.scene, self.obstacles, self.view, self.robot) as studio:
            Image.fromarray(studio.shot(*self._poses[-1])).save(path)

    def write(self, path: Path, progress: Callable[[int, int], None] | None = None) -> None:
        """FILE.mp4, or a folder of numbered PNG files. `progress(done, total)` after each frame. Raises RenderError."""
        if not self._poses:
            raise RenderError("nothing to draw: no pose was recorded")
        if path.suffix.lower() not in ("", ".mp4"):
            raise RenderError(f"cannot write {path.suffix} films: give FILE.mp4, or a folder for PNG frames")
        try:
            if path.suffix:
                path.parent.mkdir(parents=True, exist_ok=True)
                write_mp4(path, self._counted(progress), self.view.fps)
                return
            path.mkdir(parents=True, exist_ok=True)
            for k, frame in enumerate(self._counted(progress)):
                Image.fromarray(frame).save(path / f"frame_{k:05d}.png")
        except OSError as error:
            raise RenderError(f"cannot write {path}: {error.strerror or error}") from error

    def _counted(self, progress: Callable[[int, int], None] | None) -> Iterator[Frame]:
        for k, frame in enumerate(self.frames()):
            yield frame
            if progress is not None:
                progress(k + 1, len(self._poses))


class Canvas:
    """A model, drawn off-screen. `shadows` cost twice the time."""

    def __init__(self, model: mujoco.MjModel, width: int, height: int, *, shadows: bool = True) -> None:
        """width, height: of a frame [pixels]."""
        self.model, self.data = model, mujoco.MjData(model)
        self.camera = mujoco.MjvCamera()
        self._size = width, height
        self._option = mujoco.MjvOption()
        self._option.geomgroup[:] = [1, 1, 1, 0, 0, 0]
        self._shadows = shadows
        driven = [model.actuator(k).name for k in range(model.nu)]
        self._address = np.concatenate([np.arange(7), [model.joint(name).qposadr[0] for name in driven]])
        self._has = np.concatenate([np.arange(7), [7 + MOTORS.index(name) for name in driven]])

    def __enter__(self) -> Self:
        """Take an OpenGL context. Raises RenderError."""
        limit = self.model.vis.global_
        if self._size[0] > limit.offwidth or self._size[1] > limit.offheight:
            raise RenderError(f"frames may be at most {limit.offwidth} x {limit.offheight} pixels")
        self._gl = gl_context(*self._size)
        self.renderer = type(self._gl).__module__.rpartition(".")[2]
        """EGL, OSMesa: who draws."""
        self._context = mujoco.MjrContext(self.model, mujoco.mjtFontScale.mjFONTSCALE_100.value)
        mujoco.mjr_setBuffer(mujoco.mjtFramebuffer.mjFB_OFFSCREEN.value, self._context)
        self._scene = mujoco.MjvScene(self.model, maxgeom=2000)
        self._scene.flags[mujoco.mjtRndFlag.mjRND_SHADOW] = self._shadows
        self._scene.flags[mujoco.mjtRndFlag.mjRND_REFLECTION] = self._shadows
        return self

    def __exit__(self, *_: object) -> None:
        self._context.free()
        self._gl.free()

    def take_ground(self) -> None:
        """The model's ground is another one."""
        mujoco.mjr_uploadHField(self.model, self._context, 0)

    def place(self, pose: NDArray[np.float32], obstacles: tuple[Obstacle, ...], time: float) -> None:
        """The robot at `pose` (23,): position [m], quaternion w, x, y, z, joints in SDK order [rad]; the boxes where
        they are at `time` [s]."""
        self.data.qpos[self._address] = pose[self._has]
        for index, obstacle in enumerate(obstacles):
            box = box_at(obstacle, time)
            self.data.mocap_pos[index] = box.centre if present(obstacle, time) else HIDDEN_PLACE
            self.data.mocap_quat[index] = np.cos(box.yaw / 2), 0.0, 0.0, np.sin(box.yaw / 2)
        mujoco.mj_kinematics(self.model, self.data)
        mujoco.mj_camlight(self.model, self.data)

    def draw(self) -> Frame:
        """(height, width, 3) uint8, what `camera` sees."""
        width, height = self._size
        everything = mujoco.mjtCatBit.mjCAT_ALL.value
        mujoco.mjv_updateScene(
            self.model, self.data, self._option, mujoco.MjvPerturb(), self.camera, everything, self._scene
        )
        viewport = mujoco.MjrRect(0, 0, width, height)
        mujoco.mjr_render(viewport, self._scene, self._context)
        frame = np.empty((height, width, 3), np.uint8)
        mujoco.mjr_readPixels(frame, None, viewport, self._context)
        return frame[::-1]


class _Studio(Canvas):
    """A film's canvas: its camera follows the robot."""

    def __init__(self, scene: Scene, obstacles: tuple[Obstacle, ...], view: View, robot: Robot) -> None:
        sizes = [obstacle.size for obstacle in obstacles]
        built = robot.model()
        model = build(scene.height, scene.resolution, scene.origin, built, boxes=sizes)
        super().__init__(model, view.width, view.height)
        self._view, self._obstacles = view, obstacles
        self.camera.distance, self.camera.azimuth = view.distance, view.azimuth
        self.camera.elevation = view.elevation
        self._last: float | None = None

    def shot(self, time: float, pose: NDArray[np.float32]) -> Frame:
        """One frame."""
        self.place(pose, self._obstacles, time)
        target = pose[:3].astype(np.float64)
        if self._last is not None:
            share = 1.0 - np.exp(-(time - self._last) / max(self._view.follow, 1e-3))
            target = self.camera.lookat + share * (target - self.camera.lookat)
        self.camera.lookat[:] = target
        self._last = time
        return self.draw()


def require_display() -> None:
    """Raises RenderError where no window can be opened."""
    if not (os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY")):
        raise RenderError("there is no display for --viewer: draw the run afterwards with --render FILE.mp4")


def launch_viewer(model: mujoco.MjModel, data: mujoco.MjData) -> Any:
    """MuJoCo's interactive viewer on a running simulation; call its `sync` after steps. Raises RenderError."""
    require_display()
    import mujoco.viewer

    return mujoco.viewer.launch_passive(model, data)
