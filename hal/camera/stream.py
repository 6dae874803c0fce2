"""A network or USB camera by FFmpeg: RTSP, HTTP, V4L2, a file. Needs the extra `camera` (PyAV)."""

from __future__ import annotations

import threading
import time
from typing import Any

from hal.camera.camera import CameraError, CameraFrame, MountedCamera, encode

OPENING_TIME = 10.0
"""[s] a camera has until its first frame, and between two."""


class StreamCamera:
    """`CameraSource` on a stream. A thread keeps the newest frame.

    A frame is stamped when it came: what the camera and the network took before is not known.
    """

    def __init__(self, camera: MountedCamera, url: str) -> None:
        """`url`: as FFmpeg has it; `v4l2:/dev/video0` for a USB camera, `file:` for a film that is repeated."""
        self.camera = camera
        self._url = url
        self._newest: tuple[float, Any] | None = None
        self._taken = 0.0
        self._opened = 0.0
        self._failed = ""
        self._ended = threading.Event()
        self._thread: threading.Thread | None = None

    def open(self) -> str:
        """Begin to read. Raises CameraError without PyAV."""
        try:
            import av  # noqa: F401
        except ImportError as error:
            raise CameraError(
                f"camera.source {self._url} needs PyAV: uv sync --extra camera, or set camera.source=robot"
            ) from error
        self._failed, self._newest, self._opened = "", None, time.monotonic()
        self._ended.clear()
        self._thread = threading.Thread(target=self._read, name="camera", daemon=True)
        self._thread.start()
        return self._name

    @property
    def _name(self) -> str:
        """Its address without user and password."""
        scheme, _, rest = self._url.partition("://")
        return f"{scheme}://{rest.rpartition('@')[2]}" if rest else self._url

    def _read(self) -> None:
        import av

        film = self._url.startswith("file:")
        # A live stream is not buffered: what is probed at its begin is lost, and nothing is ever late.
        live = {"timeout": str(int(OPENING_TIME * 1e6)), "fflags": "nobuffer", "rtsp_transport": "tcp"}
        url, form = self._url, None
        if url.startswith("v4l2:"):
            url, form = url.removeprefix("v4l2:"), "v4l2"
        try:
            while not self._ended.is_set():
                options = {} if film else live
                count = 0
                with av.open(url, format=form, options=options, timeout=OPENING_TIME) as container:
                    for picture in container.decode(video=0):
                        count += 1
                        self._newest = (time.monotonic(), picture)
                        if self._ended.wait(1.0 / self.camera.rate if film else 0.0):
                            return
                if not (film and count):
                    self._failed = "the stream ended" if count else "there is no picture in it"
                    return
        except (av.FFmpegError, OSError, ValueError, IndexError) as error:
            self._failed = " ".join(str(error).replace(self._url, self._name).split())

    def frame(self, now: int) -> CameraFrame | None:
        """The newest frame as JPEG, if it is another one."""
        newest, wall = self._newest, time.monotonic()
        if self._failed:
            raise CameraError(f"the camera at {self._name} gives nothing: {self._failed}")
        if newest is None or newest[0] == self._taken:
            if wall - (newest[0] if newest else self._opened) > OPENING_TIME:
                raise CameraError(f"the camera at {self._name} is silent: check its address and the network")
            return None
        self._taken = newest[0]
        return CameraFrame(now - round((wall - newest[0]) * 1e9), encode(newest[1].to_image()))

    def close(self) -> None:
        """End the thread; one that waits for a dead network ends by its timeout."""
        self._ended.set()
        if self._thread is not None:
            self._thread.join(1.0)
            self._thread = None
        self._newest = None
