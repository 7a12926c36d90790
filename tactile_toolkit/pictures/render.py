"""Oblique views of solids: with a renderer where there is one, in shaded relief where there is none."""

from __future__ import annotations

import contextlib
import io
import json
import math
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

from tactile_toolkit.arithmetic import cosine_sine, moved
from tactile_toolkit.errors import install_line
from tactile_toolkit.mesh.raster import highest_faces

if TYPE_CHECKING:
    from tactile_toolkit.mesh.mesh import Mesh

__all__ = [
    "Body",
    "OBLIQUE",
    "Picture3d",
    "Renderer",
    "SAMPLING",
    "TOP",
    "View",
    "averaged",
    "fitting_scale",
    "main",
    "receive",
    "send",
    "shades",
]

# Where the light comes from: right, up and out of the picture.
_LIGHT = np.array([-0.45, 0.55, 0.70])

_DARKEST, _RANGE = 60, 180


@dataclass(frozen=True, slots=True)
class View:
    """From where a mesh is looked at, without perspective."""

    azimuth_deg: float  # how far the viewer has walked around the z axis, counter-clockwise from -y
    elevation_deg: float  # how high the viewer stands: 90 looks straight down, with x right and y up

    @property
    def axes(self) -> NDArray[np.float64]:
        """Directions right, up and towards the viewer, one a row: shape (3, 3), of length one."""
        walked, aside = cosine_sine(math.radians(self.azimuth_deg))
        level, raised = cosine_sine(math.radians(self.elevation_deg))
        towards = np.array([level * aside, -level * walked, raised])
        right = np.array([walked, aside, 0.0])
        return np.stack([right, np.cross(towards, right), towards])

    def project(self, points: NDArray[np.floating[Any]]) -> NDArray[np.float64]:
        """Turn points, shape (n, 3), into right, up and towards the viewer, in the same unit."""
        return moved(np.asarray(points, np.float64), self.axes.T)


TOP = View(0.0, 90.0)
"""Straight from above."""

OBLIQUE = View(-25.0, 42.0)
"""From the front, somewhat left and well above: digits stay readable and show their height."""


def averaged(pixels: NDArray[np.uint8], factor: int, paper: int = 255) -> NDArray[np.uint8]:
    """Return a picture, (H, W) or (H, W, 3), so many times smaller, each pixel the mean of those it covers.

    Sides that are not a multiple of ``factor`` are filled up with the level ``paper`` first.
    """
    height, width = (-(-side // factor) for side in pixels.shape[:2])
    spread = [(0, height * factor - pixels.shape[0]), (0, width * factor - pixels.shape[1])]
    whole = np.pad(pixels, [*spread, *[(0, 0)] * (pixels.ndim - 2)], constant_values=paper)
    blocks = whole.reshape(height, factor, width, factor, *pixels.shape[2:])
    sums = blocks.sum(axis=(1, 3), dtype=np.uint32)
    return np.asarray((sums + factor * factor // 2) // (factor * factor), np.uint8)


def shades(points: NDArray[np.float64], faces: NDArray[np.integer[Any]]) -> NDArray[np.uint8]:
    """Return how bright each triangle is, (F,), 60 to 240; points, (V, 3), are right, up and to the viewer.

    One that faces away is lit as if it did not, so that damaged meshes show something, too.
    """
    corners = points[np.asarray(faces)]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    normals *= np.where(normals[:, 2:] < 0, -1.0, 1.0)
    lengths = np.linalg.norm(normals, axis=1)
    light = moved(normals / np.where(lengths > 0, lengths, 1.0)[:, None], _LIGHT[:, None])[:, 0]
    return np.asarray(_DARKEST + _RANGE * np.clip(light, 0, 1)).astype(np.uint8)


SAMPLING = 2
"""Views are drawn so many times larger and averaged: smooth edges that no driver's own way decides."""

_LENGTH = struct.Struct("<q")
_HEADERS_BYTES = 4096
_SECONDS_TO_END = 5.0
_SECONDS_TO_DRAW = 120.0


@dataclass(frozen=True, slots=True, eq=False)
class Body:
    """A mesh to draw in a colour, red, green and blue; without ``lit`` in its plain colour."""

    mesh: Mesh
    colour: tuple[int, int, int]
    lit: bool = True


@dataclass(frozen=True, slots=True, eq=False)
class Picture3d:
    """A picture of bodies, without perspective: lengths along the picture plane keep their scale."""

    bodies: tuple[Body, ...]
    size_px: tuple[int, int]  # width and height
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


class Renderer:
    """Draws oblique views with pyvista in a process of its own; use it as a context.

    A graphics driver that is missing or broken ends the process that calls it; here that is a child, and the
    view is then drawn in shaded relief, as it always is without ``smooth``.
    """

    def __init__(self, smooth: bool = True) -> None:
        self._wanted = smooth
        self._child: subprocess.Popen[bytes] | None = None
        self._reason = ""

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def draw(self, picture: Picture3d) -> tuple[NDArray[np.uint8], tuple[str, ...]]:
        """Draw bodies on white paper, (H, W, 3), and say why where that had to be in shaded relief."""
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
            self._reason = f"the package 'pyvista' is not installed; next: {install_line('pictures')}"
            return None
        late = threading.Event()
        try:
            child = self._child = self._child or _start()
            with _killed_after(child, _SECONDS_TO_DRAW, late):
                send(_end_of(child.stdin), *_packed(picture))
                # Text of a site's own start-up files, read as a length, would be petabytes.
                most_bytes = 3 * SAMPLING**2 * math.prod(picture.size_px) + _HEADERS_BYTES
                _, arrays = receive(_end_of(child.stdout), most_bytes)
        except (OSError, EOFError):
            self.close()
            self._reason = (
                f"the renderer had no picture after {_SECONDS_TO_DRAW:g} s and was ended; next: draw again "
                "when the machine is less busy"
                if late.is_set()
                else "the renderer ended without a picture; next: install a graphics driver such as libegl1"
            )
            return None
        return averaged(arrays["pixels"], SAMPLING)


def shaded(picture: Picture3d) -> NDArray[np.uint8]:
    """Draw bodies in shaded relief, shape (H, W, 3); the same view that the renderer takes."""
    points, faces, colours = _joined(picture)
    width, height = (side * SAMPLING for side in picture.size_px)
    scale = picture.px_per_m * SAMPLING
    seen = picture.view.project(points)
    # Rows run downwards, and the centre of the first pixel is at column 0, row 0.
    corner = (width / 2 - 0.5, height / 2 - 0.5)
    columns, rows = ((seen[:, :2] - picture.centre_m) * (scale, -scale) + corner).T
    nearest = highest_faces(np.stack([columns, rows, seen[:, 2]]), faces, (height, width), both_sides=True)
    lit = np.repeat([body.lit for body in picture.bodies], [len(body.mesh.faces) for body in picture.bodies])
    levels = np.where(lit, shades(seen, faces) / 255.0, 1.0)
    palette = np.append(np.round(levels[:, None] * colours), [[255, 255, 255]], axis=0).astype(np.uint8)
    return averaged(palette[nearest], SAMPLING)


def send(stream: IO[bytes], words: dict[str, Any], arrays: dict[str, NDArray[Any]]) -> None:
    """Write a message of JSON values and arrays to a pipe."""
    content = io.BytesIO()
    np.savez(content, allow_pickle=False, **arrays, words=np.frombuffer(json.dumps(words).encode(), np.uint8))
    stream.write(_LENGTH.pack(content.tell()))
    stream.write(content.getbuffer())
    stream.flush()


def receive(
    stream: IO[bytes], most_bytes: int = sys.maxsize
) -> tuple[dict[str, Any], dict[str, NDArray[Any]]]:
    """Read a message from a pipe; EOFError where the other side is gone, or sends something else."""
    head = stream.read(_LENGTH.size)
    if len(head) < _LENGTH.size:
        raise EOFError
    (length,) = _LENGTH.unpack(head)
    if not 0 <= length <= most_bytes:
        raise EOFError
    content = stream.read(length)
    if len(content) < length:
        raise EOFError
    with np.load(io.BytesIO(content), allow_pickle=False) as loaded:
        arrays = {name: loaded[name] for name in loaded.files}
    return json.loads(arrays.pop("words").tobytes()), arrays


@contextlib.contextmanager
def _killed_after(child: subprocess.Popen[bytes], seconds: float, late: threading.Event) -> Iterator[None]:
    """End a process that takes longer, and tell so; who reads from it then meets the end of its output."""

    def end() -> None:
        late.set()
        child.kill()

    timer = threading.Timer(seconds, end)
    timer.start()
    try:
        yield
    finally:
        timer.cancel()
        # Else it might end the child while that draws the next picture.
        timer.join()


def _start() -> subprocess.Popen[bytes]:
    environment = dict(os.environ)
    if sys.platform.startswith("linux"):
        # Without these VTK asks for a screen first, and Mesa for a graphics card.
        environment.setdefault("VTK_DEFAULT_OPENGL_WINDOW", "vtkEGLRenderWindow")
        environment.setdefault("LIBGL_ALWAYS_SOFTWARE", "1")
    command = [sys.executable, "-m", "tactile_toolkit.pictures.render"]
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


_AMBIENT, _DIFFUSE, _SPECULAR = 0.22, 0.78, 0.12
_SHARP_EDGE_DEG = 40.0
# Direction (right, up, towards the viewer) and strength of the lights; the first is the relief's.
_LIGHTS = (((-0.5, 0.75, 0.9), 0.88), ((0.9, 0.1, 0.6), 0.30))


def main() -> None:
    """Draw until the input ends."""
    # Drivers print on descriptor 1, whatever Python calls its output: the pictures go through another one.
    output = os.fdopen(os.dup(1), "wb")
    os.dup2(2, 1)
    while True:
        try:
            words, arrays = receive(sys.stdin.buffer)
        except EOFError:
            return
        _answer(output, words, arrays)


def _answer(output: IO[bytes], words: dict[str, Any], arrays: dict[str, NDArray[Any]]) -> None:
    import pyvista as pv

    plotter = pv.Plotter(off_screen=True, window_size=words["size_px"], lighting="none")
    plotter.set_background("white")
    for number, body in enumerate(words["bodies"]):
        surface = pv.PolyData.from_regular_faces(arrays[f"vertices{number}"] * 1e3, arrays[f"faces{number}"])
        plotter.add_mesh(
            surface,
            color=body["colour"],
            lighting=body["lit"],
            smooth_shading=body["lit"],
            split_sharp_edges=body["lit"],
            feature_angle=_SHARP_EDGE_DEG,
            ambient=_AMBIENT,
            diffuse=_DIFFUSE,
            specular=_SPECULAR,
            specular_power=12,
            show_scalar_bar=False,
        )
    for direction, strength in _LIGHTS:
        light = pv.Light(light_type="camera light", intensity=strength)
        light.position, light.focal_point = direction, (0.0, 0.0, 0.0)
        plotter.add_light(light)
    points_m = np.concatenate([values for name, values in arrays.items() if name[0] == "v"])
    right, up, towards = np.array(words["axes"])
    depths = points_m @ towards
    middle_mm = 1e3 * (
        words["centre_m"][0] * right + words["centre_m"][1] * up + (depths.min() + depths.max()) / 2 * towards
    )
    reach_mm = 1e3 * float(np.ptp(depths)) + 10.0
    camera = plotter.camera
    camera.parallel_projection = True
    camera.focal_point = middle_mm.tolist()
    camera.position = (middle_mm + towards * reach_mm * 2).tolist()
    camera.up = up.tolist()
    camera.parallel_scale = 1e3 * words["size_px"][1] / (2 * words["px_per_m"])
    camera.clipping_range = (reach_mm * 0.5, reach_mm * 3.5)
    pixels = np.array(plotter.screenshot(return_img=True), np.uint8)
    plotter.close()
    send(output, {}, {"pixels": pixels[:, :, :3]})


if __name__ == "__main__":
    main()
