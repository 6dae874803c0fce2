"""Write pictures as an MP4 (AV1) with pillow alone, frame by frame: no ffmpeg, no frame list in memory."""

from __future__ import annotations

import io
import struct
from collections.abc import Iterator
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from PIL import Image

Frame = NDArray[np.uint8]
"""(height, width, 3) RGB."""


class _Reel(Image.Image):
    """An animation that fetches its next frame when pillow's encoder seeks to it; forwards only."""

    def __init__(self, frames: Iterator[Frame]) -> None:
        super().__init__()
        self._frames = frames
        self._at = -1
        self.is_animated = True
        self._advance()

    def _advance(self) -> None:
        frame = next(self._frames, None)
        if frame is None:
            raise EOFError
        picture = Image.fromarray(np.ascontiguousarray(frame))
        self.im = picture.im
        self._mode, self._size = picture.mode, picture.size
        self._at += 1

    def seek(self, frame: int) -> None:
        """Encoders go through the frames in order; the last one stays when they come back to it."""
        if frame == self._at + 1:
            self._advance()

    def tell(self) -> int:
        return self._at


def write_mp4(path: Path, frames: Iterator[Frame], fps: int, quality: int = 70) -> None:
    """Encode `frames` (at least one) into `path`. Raises OSError."""
    buffer = io.BytesIO()
    _Reel(frames).save(
        buffer, "AVIF", save_all=True, duration=round(1000 / fps), quality=quality, speed=9, max_threads=1
    )
    path.write_bytes(mp4_from_avif(buffer.getvalue()))


def mp4_from_avif(data: bytes) -> bytes:
    """An AVIF image sequence is an MP4 in all but its labels; this changes them in place, no byte moves.

    The brand becomes `isom`, the track's handler `vide`; the still-picture index and the edit list that repeats the
    animation for ever become free space, and movie and track last as long as their media.
    """
    out = bytearray(data)
    out[8:12] = b"isom"
    # 0xFFFF... says "repeat for ever"; the media header knows how long once is.
    at, size = _find(out, b"moov", b"trak", b"mdia", b"mdhd")
    if out[at + 8] != 1:
        raise ValueError("the AVIF encoder wrote a 32-bit media header, expected a 64-bit one")
    scale, duration = struct.unpack_from(">IQ", out, at + 8 + 4 + 16)
    movie, _ = _find(out, b"moov", b"mvhd")
    struct.pack_into(">IQ", out, movie + 8 + 4 + 16, scale, duration)
    track, _ = _find(out, b"moov", b"trak", b"tkhd")
    struct.pack_into(">Q", out, track + 8 + 4 + 16 + 8, duration)
    handler, _ = _find(out, b"moov", b"trak", b"mdia", b"hdlr")
    out[handler + 16 : handler + 20] = b"vide"
    for names in ((b"meta",), (b"moov", b"trak", b"edts")):
        at, size = _find(out, *names)
        if size:
            out[at + 4 : at + 8] = b"free"
    return bytes(out)


def _find(data: bytearray, *names: bytes) -> tuple[int, int]:
    """Offset and size of a nested box; (0, 0) when it is not there."""
    start, end = 0, len(data)
    for depth, name in enumerate(names):
        at = start
        while at + 8 <= end:
            size = struct.unpack_from(">I", data, at)[0]
            if data[at + 4 : at + 8] == name:
                break
            at += max(size, 8)
        else:
            return 0, 0
        if depth == len(names) - 1:
            return at, size
        start, end = at + 8, at + size
    return 0, 0
