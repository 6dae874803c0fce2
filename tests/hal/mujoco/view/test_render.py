"""Films show the robot where it was, in a file that players read."""

from __future__ import annotations

import struct
import sys
import types
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from hal.mujoco.config import Obstacle
from hal.mujoco.view.render import Film, RenderError, View, egl_works, gl_context, launch_viewer
from hal.mujoco.view.video import write_mp4
from hal.robots.go2w import facts as go2w
from hal.scenes import Scene
from hal.types import NS, GroundTruth, JointSample, Sample
from tests.places import needs_gl

SMALL = View(width=160, height=120, fps=10, distance=1.6)
LEVEL = np.array([0.0, 0.0, 0.0, 1.0])


def field() -> Scene:
    return Scene("field", np.zeros((41, 41), np.float32), 0.1, (-2.0, -2.0), (0.0, 0.0, 0.0), {})


def drive(seconds: float) -> list[Sample]:
    """True poses at 50 Hz of a robot that moves along x at 1 m/s."""
    samples: list[Sample] = []
    for k in range(round(seconds * 50) + 1):
        stamp = k * NS // 50
        samples.append(JointSample(stamp, go2w.STAND, np.zeros(16), np.zeros(16)))
        position = np.array([k / 50.0, 0.0, 0.408])
        samples.append(GroundTruth(stamp, position, LEVEL, np.zeros(3), np.zeros(3)))
    return samples


def boxes(data: bytes, start: int = 0, end: int | None = None) -> list[tuple[bytes, int, int]]:
    found = []
    at, end = start, len(data) if end is None else end
    while at + 8 <= end:
        size = struct.unpack_from(">I", data, at)[0]
        found.append((data[at + 4 : at + 8], at + 8, at + size))
        at += size
    return found


def test_a_film_keeps_poses_at_its_frame_rate() -> None:
    film = Film(field(), view=SMALL)
    film.take(drive(2.0))
    assert len(film) == 21
    fast = Film(field(), view=replace(SMALL, speed=4.0))
    fast.take(drive(2.0))
    assert len(fast) == 6, "four seconds of the run in one of the film"


def test_the_robot_is_in_the_middle_and_the_obstacle_beside_it() -> None:
    needs_gl()
    orange = Obstacle((0.6, 0.6, 0.2), (0.3, 0.3, 0.4), appear=0.05)
    film = Film(field(), (orange,), SMALL)
    film.take(drive(0.1))
    before, after = film.frames()
    assert before.shape == (120, 160, 3)
    middle = before[45:85, 55:105].astype(int)
    assert middle.min() < 40, "tyres are black"
    assert middle.max() > 190, "the shell is white"
    ground = before[100:, :20].astype(int)
    assert ground.std() < 40

    def orange_pixels(frame: np.ndarray) -> int:
        r, g, b = np.moveaxis(frame.astype(int), -1, 0)
        return int(((r > 110) & (r > 1.6 * g) & (g > b)).sum())

    assert orange_pixels(before) == 0
    assert orange_pixels(after) > 200


def test_a_folder_gets_numbered_frames_and_progress(tmp_path: Path) -> None:
    needs_gl()
    film = Film(field(), view=SMALL)
    film.take(drive(0.3))
    told: list[tuple[int, int]] = []
    film.write(tmp_path / "frames", lambda done, total: told.append((done, total)))
    names = sorted(p.name for p in (tmp_path / "frames").iterdir())
    assert names == [f"frame_{k:05d}.png" for k in range(4)]
    assert told == [(1, 4), (2, 4), (3, 4), (4, 4)]
    assert Image.open(tmp_path / "frames" / names[0]).size == (160, 120)
    film.picture(tmp_path / "last.png")
    last = np.asarray(Image.open(tmp_path / "last.png"))
    assert last.std() > 10


def test_an_mp4_is_one_video_track_of_the_right_length(tmp_path: Path) -> None:
    rng = np.random.default_rng(0)
    path = tmp_path / "film.mp4"
    write_mp4(path, iter(rng.integers(0, 255, (20, 48, 64, 3), dtype=np.uint8)), fps=10)
    data = path.read_bytes()
    top = boxes(data)
    assert next(name for name, *_ in top) == b"ftyp"
    assert data[8:12] == b"isom"
    assert b"meta" not in {name for name, *_ in top}, "no still picture beside the film"
    movie = {
        name: (a, b) for name, a, b in boxes(data, *next((a, b) for name, a, b in top if name == b"moov"))
    }
    a = movie[b"mvhd"][0]
    scale, duration = struct.unpack_from(">IQ", data, a + 4 + 16)
    assert duration / scale == pytest.approx(2.0, abs=0.01)
    track = {name: (a, b) for name, a, b in boxes(data, *movie[b"trak"])}
    assert b"edts" not in track, "plays once"
    media = {name: (a, b) for name, a, b in boxes(data, *track[b"mdia"])}
    assert data[media[b"hdlr"][0] + 8 :][:4] == b"vide"
    table = data[media[b"minf"][0] : media[b"minf"][1]]
    at = table.index(b"stsz")
    assert struct.unpack_from(">I", table, at + 12)[0] == 20, "every frame is a sample"
    assert b"av01" in table


def test_what_cannot_be_drawn_is_said_in_words(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    empty = Film(field())
    with pytest.raises(RenderError, match="no pose was recorded"):
        empty.write(tmp_path / "a.mp4")
    film = Film(field(), view=SMALL)
    film.take(drive(0.1))
    with pytest.raises(RenderError, match=r"cannot write \.avi films"):
        film.write(tmp_path / "a.avi")
    huge = Film(field(), view=View(width=9000))
    huge.take(drive(0.1))
    with pytest.raises(RenderError, match="at most 1920 x 1080"):
        huge.write(tmp_path / "a.mp4")
    monkeypatch.delenv("DISPLAY", raising=False)
    monkeypatch.delenv("WAYLAND_DISPLAY", raising=False)
    with pytest.raises(RenderError, match="there is no display"):
        launch_viewer(None, None)  # type: ignore[arg-type]


@pytest.mark.parametrize(
    ("wanted", "works", "taken"),
    [
        ("", True, "egl"),
        ("", False, "osmesa"),
        ("osmesa", True, "osmesa"),
        ("egl", False, "egl"),
        ("glfw", False, "osmesa"),
    ],
)
def test_egl_is_taken_or_osmesa_where_it_does_not_work(
    wanted: str, works: bool, taken: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    class Context:
        def __init__(self, kind: str) -> None:
            self.kind = kind

        def make_current(self) -> None:
            pass

    for kind in ("egl", "osmesa"):
        module = types.ModuleType(f"mujoco.{kind}")
        module.GLContext = lambda width, height, kind=kind: Context(kind)  # type: ignore[attr-defined]
        monkeypatch.setitem(sys.modules, f"mujoco.{kind}", module)
    monkeypatch.setenv("MUJOCO_GL", wanted)
    monkeypatch.setattr("hal.mujoco.view.render.egl_works", lambda: works)
    assert gl_context(16, 16).kind == taken


def test_egl_that_is_there_but_opens_nothing_does_not_work(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    broken = tmp_path / "mujoco"
    broken.mkdir()
    (broken / "__init__.py").touch()
    (broken / "egl.py").write_text("def GLContext(width, height):\n    raise ImportError('no device')\n")
    monkeypatch.setattr("ctypes.util.find_library", lambda name: "libEGL.so.1")
    monkeypatch.setenv("PYTHONPATH", str(tmp_path))
    assert not egl_works()
    (broken / "egl.py").write_text(
        "class GLContext:\n    def __init__(self, w, h): ...\n    def make_current(self): ...\n"
    )
    assert egl_works()
    monkeypatch.setattr("ctypes.util.find_library", lambda name: None)
    assert not egl_works()


@pytest.mark.parametrize(("wanted", "other"), [("egl", "osmesa"), ("osmesa", "egl")])
def test_a_machine_that_cannot_draw_is_told_what_to_install(
    wanted: str, other: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    module = types.ModuleType(f"mujoco.{wanted}")

    def broken(width: int, height: int) -> None:
        raise ImportError("libX.so.8: cannot open\nshared object file")

    module.GLContext = broken  # type: ignore[attr-defined]
    monkeypatch.setitem(sys.modules, f"mujoco.{wanted}", module)
    monkeypatch.setenv("MUJOCO_GL", wanted)
    with pytest.raises(RenderError) as told:
        gl_context(16, 16)
    text = str(told.value)
    assert f"cannot draw with {wanted} (libX.so.8: cannot open shared object file)" in text
    assert "libosmesa6" in text
    assert text.endswith(f"MUJOCO_GL={other}")
