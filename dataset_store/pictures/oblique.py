"""Oblique views of solids: with a renderer where there is one, in shaded relief where there is none."""

from __future__ import annotations

import contextlib
import io
import json
import os
import struct
import subprocess
import sys
import threading
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from importlib.util import find_spec
from typing import IO, TYPE_CHECKING, Any, Self

import numpy as np
from numpy.typing import NDArray

from dataset_store.pictures.shading import OBLIQUE, View, averaged, face_buffer, shades

if TYPE_CHECKING:
    from dataset_store.mesh import Mesh

__all__ = ["SAMPLING", "Body", "Picture3d", "Studio", "fitting_scale", "receive", "send"]

SAMPLING = 2
"""Views are drawn so many times larger and averaged: smooth edges that no driver's own way decides."""

_EXTRA = "pip install 'tactile-toolkit[pictures]'"
_LENGTH = struct.Struct("<q")
_SECONDS_TO_END = 5.0
_SECONDS_TO_DRAW = 120.0


@dataclass(frozen=True, slots=True, eq=False)
class Body:
    """Something to draw.

    Attributes
    ----------
    mesh : Mesh
        Metres.
    colour : tuple of int
        Red, green and blue, 0 to 255.
    lit : bool
        False draws it in its plain colour.
    """

    mesh: Mesh
    colour: tuple[int, int, int]
    lit: bool = True


@dataclass(frozen=True, slots=True, eq=False)
class Picture3d:
    """A picture of bodies, without perspective: lengths along the picture plane keep their scale everywhere.

    Attributes
    ----------
    bodies : tuple of Body
        What stands there.
    size_px : tuple of int
        Width and height.
    px_per_m : float
        Scale.
    view : View
        From where.
    """

    bodies: tuple[Body, ...]
    size_px: tuple[int, int]
    px_per_m: float
    view: View = OBLIQUE

    @property
    def centre_m(self) -> NDArray[np.float64]:
        """What lies in the middle of the picture, shape (2,): right and up, metres."""
        low, high = _extent_m(self.bodies, self.view)
        return (low + high) / 2


def fitting_scale(bodies: Sequence[Body], size_px: tuple[int, int], view: View = OBLIQUE) -> float:
    """Return the scale, pixels per metre, at which bodies just fill a picture of some size."""
    low, high = _extent_m(bodies, view)
    return float((np.array(size_px) / np.maximum(high - low, 1e-9)).min())


class Studio:
    """Where oblique views are made. Use it as a context: the renderer is a process of its own.

    A graphics driver that is missing or broken ends the process that calls it; here that is a child, and the
    view is then drawn in shaded relief.

    Parameters
    ----------
    renderer : bool
        False draws in shaded relief only.
    """

    def __init__(self, renderer: bool = True) -> None:
        self._wanted = renderer
        self._child: subprocess.Popen[bytes] | None = None
        self._reason = ""

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def draw(self, picture: Picture3d) -> tuple[NDArray[np.uint8], tuple[str, ...]]:
        """Draw bodies.

        Returns
        -------
        pixels : ndarray of uint8, shape (H, W, 3)
            On white paper.
        notes : tuple of str
            What there is to say: empty, or that the renderer is not there.
        """
        if not self._wanted:
            return shaded(picture), ()
        pixels = self._rendered(picture)
        if pixels is not None:
            return pixels, ()
        note = f"the oblique view is in shaded relief: {self._reason}"
        return shaded(picture), (note,)

    def close(self) -> None:
        """End the renderer's process."""
        child, self._child = self._child, None
        if child is None:
            return
        with contextlib.suppress(OSError):
            _end_of(child.stdin).close()
        try:
            child.wait(_SECONDS_TO_END)
        except subprocess.TimeoutExpired:
            child.kill()
            child.wait()
        _end_of(child.stdout).close()

    def _rendered(self, picture: Picture3d) -> NDArray[np.uint8] | None:
        if self._reason:
            return None
        if find_spec("pyvista") is None:
            self._reason = f"the package 'pyvista' is not installed; next: {_EXTRA}"
            return None
        try:
            child = self._child = self._child or _start()
            with _killed_after(child, _SECONDS_TO_DRAW):
                send(_end_of(child.stdin), *_packed(picture))
                _, arrays = receive(_end_of(child.stdout))
        except (OSError, EOFError):
            self.close()
            self._reason = (
                "the renderer ended without a picture; next: install a graphics driver such as libegl1"
            )
            return None
        return averaged(arrays["pixels"], SAMPLING)


def shaded(picture: Picture3d) -> NDArray[np.uint8]:
    """Draw bodies in shaded relief, shape (H, W, 3); the same view that the renderer takes."""
    points, faces, colours = _joined(picture)
    width, height = (side * SAMPLING for side in picture.size_px)
    scale = picture.px_per_m * SAMPLING
    seen = picture.view.project(points)
    places = np.empty_like(seen)
    places[:, :2] = (seen[:, :2] - picture.centre_m) * (scale, -scale) + (width / 2, height / 2)
    places[:, 2] = seen[:, 2]
    lit = np.repeat([body.lit for body in picture.bodies], [len(body.mesh.faces) for body in picture.bodies])
    levels = np.where(lit, shades(seen, faces) / 255.0, 1.0)
    palette = np.append(np.round(levels[:, None] * colours), [[255, 255, 255]], axis=0).astype(np.uint8)
    return averaged(palette[face_buffer(places, faces, (width, height))], SAMPLING)


def send(stream: IO[bytes], words: dict[str, Any], arrays: dict[str, NDArray[Any]]) -> None:
    """Write a message of JSON values and arrays to a pipe."""
    content = io.BytesIO()
    np.savez(content, allow_pickle=False, **arrays, words=np.frombuffer(json.dumps(words).encode(), np.uint8))
    stream.write(_LENGTH.pack(content.tell()))
    stream.write(content.getbuffer())
    stream.flush()


def receive(stream: IO[bytes]) -> tuple[dict[str, Any], dict[str, NDArray[Any]]]:
    """Read a message from a pipe.

    Raises
    ------
    EOFError
        The other side is gone.
    """
    head = stream.read(_LENGTH.size)
    if len(head) < _LENGTH.size:
        raise EOFError
    (length,) = _LENGTH.unpack(head)
    content = stream.read(length)
    if len(content) < length:
        raise EOFError
    with np.load(io.BytesIO(content), allow_pickle=False) as loaded:
        arrays = {name: loaded[name] for name in loaded.files}
    return json.loads(arrays.pop("words").tobytes()), arrays


@contextlib.contextmanager
def _killed_after(child: subprocess.Popen[bytes], seconds: float) -> Iterator[None]:
    """End a process that takes longer; whoever reads from it then meets the end of its output."""
    timer = threading.Timer(seconds, child.kill)
    timer.start()
    try:
        yield
    finally:
        timer.cancel()
        timer.join()


def _start() -> subprocess.Popen[bytes]:
    environment = dict(os.environ)
    if sys.platform.startswith("linux"):
        # Without these VTK asks for a screen first, and Mesa for a graphics card.
        environment.setdefault("VTK_DEFAULT_OPENGL_WINDOW", "vtkEGLRenderWindow")
        environment.setdefault("LIBGL_ALWAYS_SOFTWARE", "1")
    command = [sys.executable, "-m", "dataset_store.pictures.rendering"]
    # The drivers write to stderr what only they care about.
    return subprocess.Popen(
        command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, env=environment
    )


def _packed(picture: Picture3d) -> tuple[dict[str, Any], dict[str, NDArray[Any]]]:
    words = {
        "size_px": [side * SAMPLING for side in picture.size_px],
        "px_per_m": picture.px_per_m * SAMPLING,
        "axes": picture.view.axes.tolist(),
        "centre_m": picture.centre_m.tolist(),
        "bodies": [{"colour": body.colour, "lit": body.lit} for body in picture.bodies],
    }
    arrays: dict[str, NDArray[Any]] = {}
    for number, body in enumerate(picture.bodies):
        arrays[f"vertices{number}"] = np.asarray(body.mesh.vertices_m, np.float64)
        arrays[f"faces{number}"] = np.asarray(body.mesh.faces, np.int64)
    return words, arrays


def _joined(
    picture: Picture3d,
) -> tuple[NDArray[np.float64], NDArray[np.int64], NDArray[np.float64]]:
    counts = np.cumsum([0, *(len(body.mesh.vertices_m) for body in picture.bodies)])
    points = np.concatenate([np.asarray(body.mesh.vertices_m, np.float64) for body in picture.bodies])
    faces = [body.mesh.faces + start for body, start in zip(picture.bodies, counts, strict=False)]
    colours = [np.tile(np.array(body.colour, float), (len(body.mesh.faces), 1)) for body in picture.bodies]
    return points, np.concatenate(faces).astype(np.int64), np.concatenate(colours)


def _extent_m(bodies: Sequence[Body], view: View) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    seen = [view.project(body.mesh.vertices_m)[:, :2] for body in bodies]
    return np.min([part.min(axis=0) for part in seen], axis=0), np.max([p.max(axis=0) for p in seen], axis=0)


def _end_of(stream: IO[bytes] | None) -> IO[bytes]:
    if stream is None:
        raise EOFError
    return stream
