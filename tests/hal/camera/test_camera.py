"""Cameras: where a point falls in the picture, and what sources do when a camera does not answer."""

from __future__ import annotations

import io
import math
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from PIL import Image
from pydantic import ValidationError

from hal.camera import CameraConfig, CameraError, MountedCamera
from hal.camera.stream import StreamCamera
from hal.mujoco.config import Obstacle
from hal.mujoco.view.camera import DRAWN_SIDE, LEAST_CELL, RenderedCamera, coarse_ground
from hal.rotation import rotation_rpy
from hal.scenes import Scene
from hal.types import Extrinsics
from hal.unitree import api, video
from hal.unitree.api import Request, Response
from hal.unitree.video import HeadCamera
from tests.places import needs_gl

CAMERA = MountedCamera("front", Extrinsics((0.3, 0.0, 0.1)), 320, 240, math.radians(90.0), 5.0)
LEVEL = np.array([0.0, 0.0, 0.0, 1.0])
ANGLE = st.floats(-1.2, 1.2)


def jpeg(colour: tuple[int, int, int] = (200, 30, 30)) -> bytes:
    out = io.BytesIO()
    Image.new("RGB", (32, 24), colour).save(out, "JPEG")
    return out.getvalue()


def project(camera: MountedCamera, points: np.ndarray) -> np.ndarray:
    """Points (n, 3) in base_link [m] -> (n, 3): column, row [pixels] and depth [m], by what a camera tells of
    itself."""
    seen = (points - camera.mount.translation) @ camera.rotation @ camera.matrix.T
    return np.column_stack([seen[:, :2] / seen[:, 2:], seen[:, 2]])


def test_ahead_is_the_centre_left_is_left_up_is_up() -> None:
    pixels = project(CAMERA, np.array([[2.3, 0.0, 0.1], [2.3, 1.0, 0.1], [2.3, 0.0, 1.1]]))
    assert pixels[0] == pytest.approx([160.0, 120.0, 2.0])
    assert pixels[1] == pytest.approx([80.0, 120.0, 2.0]), "half of 45 deg to the side by its tangent"
    assert pixels[2] == pytest.approx([160.0, 40.0, 2.0])


@given(ANGLE, ANGLE, ANGLE, st.floats(0.3, 2.7))
def test_an_edge_of_the_picture_is_half_a_field_of_view_aside(
    roll: float, pitch: float, yaw: float, fov: float
) -> None:
    camera = MountedCamera("front", Extrinsics((0.3, -0.1, 0.2), (roll, pitch, yaw)), 64, 48, fov, 1.0)
    mount = rotation_rpy(roll, pitch, yaw)
    views = [(1.0, math.tan(0.5 * fov), 0.0), (1.0, 0.0, math.tan(0.5 * camera.vertical_fov))]  # left, top
    pixels = project(camera, camera.mount.translation + 1.5 * np.array(views) @ mount.T)
    assert pixels == pytest.approx(np.array([[0.0, 24.0, 1.5], [32.0, 0.0, 1.5]]), abs=1e-9)
    assert camera.vertical_fov < fov


@pytest.mark.parametrize("source", ["", "none", "rtsp:", "ftp://host/x", "v4l2:"])
def test_a_source_that_is_none_is_refused(source: str) -> None:
    with pytest.raises(ValidationError):
        CameraConfig(source=source)


def test_no_camera() -> None:
    assert CameraConfig(source="off").mounted() is None


def test_a_box_is_drawn_where_it_is_projected() -> None:
    needs_gl()
    scene = Scene("field", np.zeros((41, 41), np.float32), 0.2, (-4.0, -4.0), (0.0, 0.0, 0.0), {})
    box = Obstacle((2.0, 0.4, 0.5), (0.2, 0.2, 0.2), appear=1.0)
    source = RenderedCamera(CAMERA, scene, (box,))
    assert "320 x 240" in source.open()
    try:
        assert source.frame(0) is None, "nobody told where the robot is"
        pictures = []
        for stamp in (500_000_000, 1_500_000_000):
            source.follow(stamp, np.array([0.0, 0.0, 0.4]), LEVEL)
            frame = source.frame(0)
            assert frame is not None
            assert frame.stamp == stamp
            pictures.append(np.asarray(Image.open(io.BytesIO(frame.jpeg)), np.int64))
        assert source.frame(0) is None, "the same pose is no new picture"
    finally:
        source.close()
    changed = np.abs(pictures[1] - pictures[0]).sum(axis=2) > 60
    rows, columns = np.nonzero(changed)
    corners = np.array(
        [[2.0 + x, 0.4 + y, 0.1 + z] for x in (-0.1, 0.1) for y in (-0.1, 0.1) for z in (-0.1, 0.1)]
    )
    expected = project(CAMERA, corners)  # the robot stands 0.4 m high
    assert columns.min() == pytest.approx(expected[:, 0].min(), abs=2.0)
    assert columns.max() == pytest.approx(expected[:, 0].max(), abs=3.0)
    assert rows.min() == pytest.approx(expected[:, 1].min(), abs=2.0)


def test_a_large_site_is_drawn_around_the_robot_as_a_small_one() -> None:
    needs_gl()
    wide = np.zeros((40, 600), np.float32)
    wide[:, 550:553] = 1.0
    pictures = []
    for height, east in ((wide, 0.0), (np.ascontiguousarray(wide[:, 400:]), 40.0)):
        scene = Scene("wall", height, 0.1, (east, -2.0), (east + 1.0, 0.0, 0.0), {})
        source = RenderedCamera(CAMERA, scene)
        source.open()
        try:
            for x in (east + 1.0, 52.0):
                source.follow(round(x), np.array([x, 0.0, 0.4]), LEVEL)
                frame = source.frame(0)
                assert frame is not None
            assert source._canvas is not None
            assert source._canvas.model.hfield_data.size <= (DRAWN_SIDE / LEAST_CELL) ** 2
        finally:
            source.close()
        pictures.append(np.asarray(Image.open(io.BytesIO(frame.jpeg)), np.int64))
    ahead = [picture[60:110, 150:170].sum(axis=2).mean() for picture in pictures]
    assert ahead[0] == pytest.approx(ahead[1], abs=6.0), "the wall 3 m ahead"
    assert abs(pictures[0][10:20, 150:170].sum(axis=2).mean() - ahead[0]) > 60.0, "the sky is another colour"


@given(st.integers(2, 9), st.integers(2, 9), st.sampled_from((0.01, 0.02, 0.05)))
def test_ground_for_pictures_is_never_lower_and_lies_where_it_lay(
    rows: int, cols: int, resolution: float
) -> None:
    height = np.random.default_rng(rows * cols).uniform(0.0, 1.0, (rows, cols)).astype(np.float32)
    scene = Scene("any", height, resolution, (1.0, -2.0), (1.0, -2.0, 0.0), {})
    coarse, cell, origin = coarse_ground(scene)
    if coarse.shape != height.shape:
        assert cell == pytest.approx(LEAST_CELL)
    for row in range(rows):
        for col in range(cols):
            x, y = 1.0 + col * resolution, -2.0 + row * resolution
            r, c = round((y - origin[1]) / cell - 1e-9), round((x - origin[0]) / cell - 1e-9)
            around = coarse[max(r - 1, 0) : r + 2, max(c - 1, 0) : c + 2]
            assert around.max() >= height[row, col]
    assert coarse.max() == height.max()


class Hub:
    """A link to a robot that answers as it is told."""

    def __init__(self) -> None:
        self.asked: list[Request] = []
        self.answers: list[Response] = []
        self.there = True

    def send(self, service: str, request: Request) -> None:
        assert service == api.VIDEO
        self.asked.append(Request.unpack(request.pack()))

    def responses(self, _service: str) -> list[Response]:
        answers, self.answers = self.answers, []
        return [Response.unpack(answer.pack()) for answer in answers]

    def reachable(self, _service: str) -> bool:
        return self.there

    def close(self) -> None:
        """Nothing to release."""


@pytest.fixture
def wall(monkeypatch: pytest.MonkeyPatch) -> list[float]:
    """The time [s], moved by hand."""
    now = [100.0]
    monkeypatch.setattr(video.time, "monotonic", lambda: now[0])
    return now


def test_a_picture_of_the_robot_is_stamped_when_it_was_asked_for(wall: list[float]) -> None:
    hub = Hub()
    head = HeadCamera(CAMERA, "lo", 1, hub)  # type: ignore[arg-type]
    head.open()
    assert head.frame(1000) is None
    assert head.frame(2000) is None
    assert [request.api for request in hub.asked] == [api.Video.GET_IMAGE_SAMPLE], "one at a time"
    picture = jpeg()
    hub.answers = [
        Response(hub.asked[0].id + 7, 1001, 0, "", b"late"),
        Response(hub.asked[0].id, 1001, 0, "", picture),
    ]
    frame = head.frame(3000)
    assert frame is not None
    assert (frame.stamp, frame.jpeg) == (1000, picture)
    assert len(hub.asked) == 2, "the next one is asked for"


@pytest.mark.parametrize(
    ("answer", "words"),
    [((3203, b""), "not implemented"), ((0, b"PNG"), "no JPEG"), ((0, b""), "no JPEG")],
)
def test_a_camera_that_gives_none_says_why(wall: list[float], answer: tuple[int, bytes], words: str) -> None:
    hub = Hub()
    head = HeadCamera(CAMERA, "lo", 1, hub)  # type: ignore[arg-type]
    head.open()
    head.frame(0)
    hub.answers = [Response(hub.asked[0].id, 1001, answer[0], "", answer[1])]
    with pytest.raises(CameraError, match=words):
        head.frame(1)


def test_a_request_that_is_lost_is_repeated_and_a_camera_that_stays_silent_is_told(wall: list[float]) -> None:
    hub = Hub()
    hub.there = False
    head = HeadCamera(CAMERA, "lo", 1, hub)  # type: ignore[arg-type]
    head.open()
    for _ in range(4):
        head.frame(0)
        wall[0] += 1.2
    assert len(hub.asked) == 4
    wall[0] += 2.0
    with pytest.raises(CameraError, match="is not there"):
        head.frame(0)


@pytest.mark.parametrize("cut", range(1, 12))
def test_an_answer_that_is_cut_off_is_no_answer(cut: int) -> None:
    whole = Response(5, 1001, 0, "{}", b"0123456789").pack()
    assert Response.unpack(whole).binary == b"0123456789"
    with pytest.raises(api.WireError):
        Response.unpack(whole[:-cut])


def test_a_stream_is_read_by_ffmpeg(tmp_path: Path) -> None:
    av = pytest.importorskip("av")
    file = tmp_path / "red.mjpeg"
    with av.open(str(file), "w", format="mjpeg") as out:
        stream = out.add_stream("mjpeg", rate=5)
        stream.width, stream.height, stream.pix_fmt = 64, 48, "yuvj420p"
        for _ in range(3):
            picture = av.VideoFrame.from_ndarray(
                np.full((48, 64, 3), (200, 30, 30), np.uint8), format="rgb24"
            )
            out.mux(stream.encode(picture))
        out.mux(stream.encode())
    source = StreamCamera(CAMERA, f"file:{file}")
    source.open()
    try:
        frame = None
        while frame is None:  # its thread opens the file; a camera that is silent raises
            frame = source.frame(10_000_000_000)
    finally:
        source.close()
    assert 0 < frame.stamp <= 10_000_000_000
    red, green, _ = np.asarray(Image.open(io.BytesIO(frame.jpeg)), float).mean(axis=(0, 1))
    assert red > 150 > green


def test_a_stream_that_is_not_there_is_told_without_its_password() -> None:
    pytest.importorskip("av")
    source = StreamCamera(CAMERA, "http://user:secret@127.0.0.1:9/x")
    source.open()
    try:
        with pytest.raises(CameraError) as told:
            list(iter(lambda: source.frame(0), b""))  # until it raises
    finally:
        source.close()
    assert "127.0.0.1:9" in str(told.value)
    assert "secret" not in str(told.value)
