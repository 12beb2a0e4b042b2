"""Films, frame by frame, by the ffmpeg that imageio-ffmpeg brings."""

from __future__ import annotations

import contextlib
import errno
import subprocess
import tempfile
from fractions import Fraction
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..base.imports import needs

QUALITY = 15  # constant rate factor of H.264: 0 loses nothing, 51 is the worst


def find_ffmpeg() -> str:
    """The program, or an ImportError that says what to install."""
    told = 'imageio-ffmpeg is missing: pip install "substep[plot]" for movies'
    with needs("imageio_ffmpeg", told):
        import imageio_ffmpeg
    try:
        return str(imageio_ffmpeg.get_ffmpeg_exe())
    except RuntimeError as error:
        raise ImportError(f"imageio-ffmpeg: {error}") from None


class Film:
    """An MP4 file (H.264) that is written; it is whole once the `with` has ended without an error.

    Parameters
    ----------
    path : Path
        The file; an existing one is replaced.
    size : tuple of int
        Width and height [pixels], even numbers.
    fps : float
        Frames shown per second.

    Raises
    ------
    OSError
        If ffmpeg fails, as it does on a full disk.
    """

    def __init__(self, path: Path, size: tuple[int, int], fps: float) -> None:
        self._path = path
        rate = Fraction(fps).limit_denominator(1_000_000)
        raw = ["-f", "rawvideo", "-pix_fmt", "rgb24", "-s", "{}x{}".format(*size), "-r", str(rate)]
        coded = ["-c:v", "libx264", "-crf", str(QUALITY), "-pix_fmt", "yuv420p"]
        program = [find_ffmpeg(), "-y", "-v", "error"]
        self._words = tempfile.TemporaryFile()
        try:
            self._process = subprocess.Popen(
                [*program, *raw, "-i", "-", "-an", *coded, f"file:{path}"],
                stdin=subprocess.PIPE,
                stdout=subprocess.DEVNULL,
                stderr=self._words,
                start_new_session=True,  # Ctrl-C is for us
            )
        except BaseException:
            self._words.close()
            raise

    def add(self, pixels: NDArray[np.uint8]) -> None:
        """Add a frame, shape (height, width, 3)."""
        assert self._process.stdin is not None
        try:
            self._process.stdin.write(np.ascontiguousarray(pixels).data)
        except OSError:  # it has ended, and says why
            self._end()
            raise

    def _end(self) -> None:
        assert self._process.stdin is not None
        with contextlib.suppress(OSError):
            self._process.stdin.close()
        if code := self._process.wait():
            self._words.seek(0)
            words = self._words.read().decode(errors="replace").strip()[-300:]
            why = words or f"it ended with {code}"
            raise OSError(errno.EIO, f"ffmpeg failed: {why}", str(self._path))

    def __enter__(self) -> Film:
        return self

    def __exit__(self, kind: object, *_: Any) -> None:
        try:
            if kind is None:
                self._end()
        finally:
            if self._process.poll() is None:
                self._process.kill()
                self._process.wait()
            assert self._process.stdin is not None
            with contextlib.suppress(OSError):
                self._process.stdin.close()
            self._words.close()
