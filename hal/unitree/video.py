"""The camera in the robot's head, over its video service: one JPEG for each request, without a stamp of its own."""

from __future__ import annotations

import time

from hal.camera import CameraError, CameraFrame, MountedCamera
from hal.contract import BackendError
from hal.unitree import api
from hal.unitree.api import Request
from hal.unitree.link import Link

ANSWER_PATIENCE = 1.0
"""[s] for an answer, then the request is repeated."""
SILENT_AFTER = 5.0
"""[s] without a picture until the camera counts as gone."""
JPEG = b"\xff\xd8"


class HeadCamera:
    """`hal.camera.CameraSource` of the Go2's own camera. A picture is stamped when it was asked for: it is no older."""

    def __init__(self, camera: MountedCamera, interface: str, domain: int, link: Link | None = None) -> None:
        """`link`: instead of one of its own; for tests."""
        self.camera = camera
        self._interface, self._domain = interface, domain
        self._link = link
        self._asked: tuple[int, int, float] | None = None
        """Id of the request under way, source clock [ns] and time [s] at which it was sent."""
        self._heard = 0.0

    def open(self) -> str:
        """Join the robot's network. Raises CameraError."""
        if self._link is None:
            from hal.unitree.factory import check
            from hal.unitree.link import DdsLink

            try:
                check(self._interface)
                self._link = DdsLink(self._interface, self._domain, [], (api.VIDEO,))
            except BackendError as error:
                raise CameraError(str(error)) from error
        self._heard = time.monotonic()
        return f"the robot's own, by its service {api.VIDEO}"

    def frame(self, now: int) -> CameraFrame | None:
        """The picture asked for before, if it came; asks for the next one."""
        assert self._link is not None, "open it first"
        wall = time.monotonic()
        found = None
        for response in self._link.responses(api.VIDEO):
            if self._asked is None or response.id != self._asked[0]:
                continue
            stamp, self._asked = self._asked[1], None
            if response.code != 0:
                raise CameraError(f"the robot's camera gives no picture: {api.describe(response.code)}")
            if not response.binary.startswith(JPEG):
                raise CameraError("the robot's camera sent what is no JPEG: its firmware is not known here")
            found, self._heard = CameraFrame(stamp, response.binary), wall
        if wall - self._heard > SILENT_AFTER:
            why = "is silent" if self._link.reachable(api.VIDEO) else f"is not there (service {api.VIDEO})"
            raise CameraError(f"the robot's camera {why}: is it switched on in the app?")
        if self._asked is None or wall - self._asked[2] > ANSWER_PATIENCE:
            self._asked = time.monotonic_ns(), now, wall
            self._link.send(api.VIDEO, Request(self._asked[0], api.Video.GET_IMAGE_SAMPLE))
        return found

    def close(self) -> None:
        """Leave the network."""
        if self._link is not None:
            self._link.close()
            self._link = None
