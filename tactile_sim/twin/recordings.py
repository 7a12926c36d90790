"""Touches of known solids by one sensor, the input of its calibration, and reliefs of the solids."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace

import numpy as np

from tactile_sim.optics.rendering import require_images
from tactile_sim.press.press_kernels import rasterise
from tactile_sim.press.pressable import Pressable
from tactile_sim.twin import surface_kernels
from tactile_sim.twin.gel import WHOLE
from tactile_sim.user_values import real_array, shown
from tactile_toolkit import checked_fields
from tactile_toolkit.errors import InputError
from tactile_toolkit.mesh import Mesh, MeshLike
from tactile_toolkit.touch import MAX_IMAGE_PIXELS
from tactile_toolkit.value_types import AnyArray, Bool, Float32, Float64, Floating, Int64, UInt8

_PITCH_M = 5e-5  # the pixel of a GelSight Mini has 59 micrometres
_MAX_POINTS = 1 << 24
_MARGIN_M = 2e-4  # of plate around the solid
_MIN_PX = 32  # kernels of the gel need some room
_MAX_BYTES = 1 << 30
_TOLERANCES = (6.0, 4.0, 3.0, 3.0)  # multiples of the noise
_MIN_AGREEING = 0.03  # of an image
_LEAST_LEVEL = 1
MOST_LEVEL = 253
"""Levels up to the first and above the second count as saturated."""

MIN_UNSATURATED = 0.25
"""Share of the pixels of a usable image that are not saturated."""

_NO_BACKGROUND: UInt8 = np.empty((0, 0, 0, 3), np.uint8)


@dataclass(frozen=True, eq=False)
class Relief:
    """Heights above the plate, metres, shape (rows, columns), first row at the least y.

    ``corner`` is x and y of the first point and the distances of points along x and y, metres.
    """

    heights_m: Float32
    corner: Float64

    @classmethod
    def of(cls, solid: MeshLike | Pressable) -> Relief:
        """Return the relief of a solid that stands on the plate; InputError if it is open or too large."""
        prepared = Pressable.of(solid)
        low = prepared.vertices_m[:, :2].min(axis=0) - _MARGIN_M
        sides = np.ptp(prepared.vertices_m[:, :2], axis=0) + 2 * _MARGIN_M
        columns, rows = np.ceil(sides / _PITCH_M).astype(np.int64) + 1
        if columns * rows > _MAX_POINTS:
            raise InputError(
                f"a solid of {1e3 * sides[0]:.4g} x {1e3 * sides[1]:.4g} mm is too large to be touched; "
                "expected metres",
                next="check the unit of the mesh",
            )
        out = np.zeros((rows, columns))
        affine = np.zeros((3, 4))
        affine[0, 0] = affine[1, 1] = 1 / _PITCH_M
        affine[:2, 3] = -low / _PITCH_M
        affine[2, 2:] = 1.0, -prepared.foot_m
        rasterise(out, prepared.vertices_m, prepared.faces, prepared.blocks_m, affine, None)
        corner = np.array([low[0], low[1], _PITCH_M, _PITCH_M])
        return cls(np.ascontiguousarray(out[::-1], np.float32), corner)

    def sampled(
        self,
        pose: Float64,
        half_m: Float64,
        size: tuple[int, ...],
        span: Float64 = WHOLE,
        level_m: float = 0.0,
    ) -> Float64:
        """Return how far the relief rises above a level in each pixel of an image, metres, (H, W).

        ``pose`` is the point under the middle, x and y, metres, and the turn, radians; ``half_m`` half of
        width and height; ``span`` the share of them that is sampled, more than 1 with a margin.
        """
        cosine = np.cos(pose[2])
        sine = np.sin(pose[2])
        turned = np.array([[cosine, sine], [-sine, cosine]]) * half_m
        out = np.empty(size)
        affine = np.column_stack([turned, pose[:2]])
        surface_kernels.sample_relief(out, self.heights_m, self.corner, affine, span, level_m)
        return out

    @property
    def top_m(self) -> float:
        """Greatest height, metres."""
        return float(self.heights_m.max())


def unsaturated(image: UInt8 | Float32) -> Bool:
    """Return which pixels (H, W) of an image are not saturated in any colour."""
    return np.asarray(((image > _LEAST_LEVEL) & (image <= MOST_LEVEL)).all(axis=-1))


def shrunk(image: UInt8 | Float32, factor: int) -> Float32:
    """Return an image (H, W) or (H, W, k), smaller by a factor: means over blocks of pixels."""
    levels = np.asarray(image, np.float32)
    height, width = (side // factor * factor for side in levels.shape[:2])
    rows = np.asarray(sum(levels[first:height:factor] for first in range(factor)))
    means = sum(rows[:, first:width:factor] for first in range(factor)) / np.float32(factor * factor)
    return np.asarray(means)


def frame_gains(image: Floating, expected: Floating, noise: float) -> Float64:
    """Return by how much brighter an image is than expected, for each colour, (3,).

    Only pixels that agree in all colours count: where a gel is touched, an image is not the expected one.
    Every fourth pixel is enough. ``noise`` is that of a pixel, in levels.
    """
    image = image[::2, ::2]
    expected = expected[::2, ::2]
    gains = np.median((image + 1.0) / (expected + 1.0), axis=(0, 1))
    for times in _TOLERANCES:
        off = np.abs(image - gains * expected).max(axis=-1)
        agrees = (off < times * noise) & (image.max(axis=-1) <= MOST_LEVEL)
        if agrees.mean() < _MIN_AGREEING:
            break
        gains = (image * expected)[agrees].sum(axis=0) / (expected * expected)[agrees].sum(axis=0)
    return np.asarray(gains, np.float64)


@dataclass(frozen=True, eq=False)
class Recordings:
    """Touches of known solids.

    Attributes
    ----------
    images : ndarray of uint8, shape (N, H, W, 3)
        One image of each touch, red, green and blue.
    object_ids : ndarray of int64, shape (N,)
        Id of the solid that was touched.
    solids : mapping of int to mesh
        Closed meshes, metres, by object id.
    backgrounds : ndarray of uint8, shape (B, H, W, 3)
        Images without contact; without them, the background is found from the touches.
    sensor_m : ndarray of float64, shape (N, 3), optional
        Position of the sensor, metres, cell frame: x, y, and the height z at which it stopped, NaN where the
        height is unknown. Without positions, the touches are located by matching.
    object_poses : ndarray of float64, shape (N, 3), optional
        x and y of the origin of the mesh, metres, cell frame, and its turn about z as seen by the sensor,
        radians; zeros by default.
    names : tuple of str
        Names of the touches in messages; numbers by default.

    Raises
    ------
    InputError
        Arrays have other types, shapes or lengths, numbers are not finite, or solids are unknown.
    """

    images: UInt8
    object_ids: Int64
    solids: Mapping[int, MeshLike] = field(repr=False)
    backgrounds: UInt8 = field(default_factory=lambda: _NO_BACKGROUND)
    sensor_m: Float64 | None = None
    object_poses: Float64 | None = None
    names: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        _require_images(self.images, "images")
        count = len(self.images)
        if not isinstance(self.backgrounds, np.ndarray) or self.backgrounds.size:
            _require_images(self.backgrounds, "backgrounds")
            if self.backgrounds.shape[1:] != self.images.shape[1:]:
                raise InputError(
                    f"backgrounds have the shape {self.backgrounds.shape[1:]}, and images "
                    f"{self.images.shape[1:]}; expected images of one size"
                )
        if real_array(self.object_ids) is None or np.shape(self.object_ids) != (count,):
            raise InputError(f"object_ids is {shown(self.object_ids)}; expected an integer for each touch")
        ids = np.asarray(self.object_ids)
        if ids.dtype.kind not in "iu":
            raise InputError(f"object_ids are of {ids.dtype}; expected integers")
        if not isinstance(self.solids, Mapping):
            raise InputError(f"solids are {shown(self.solids)}; expected meshes by object id")
        unknown = sorted(set(ids.tolist()) - set(self.solids))
        if unknown:
            raise InputError(
                f"solids {', '.join(map(str, unknown[:5]))} were touched and are not among the "
                f"{len(self.solids)} solids",
                next="give the set of solids that were printed",
            )
        for name, allows_nan in (("sensor_m", (2,)), ("object_poses", ())):
            values = getattr(self, name)
            if values is not None:
                object.__setattr__(self, name, _checked_poses(values, count, name, allows_nan))
        if self.object_poses is None:
            object.__setattr__(self, "object_poses", np.zeros((count, 3)))
        object.__setattr__(self, "object_ids", ids.astype(np.int64))
        meshes = {int(key): Mesh.of(self.solids[key]) for key in sorted(set(ids.tolist()))}
        object.__setattr__(self, "solids", meshes)
        names = checked_fields.to_builtin(self.names)
        if isinstance(names, tuple) and not names:
            names = tuple(map(str, range(count)))
        if (
            not isinstance(names, tuple)
            or len(names) != count
            or not all(isinstance(name, str) for name in names)
        ):
            raise InputError(f"names are {shown(self.names)}; expected a text for each of {count} touches")
        object.__setattr__(self, "names", names)

    def __len__(self) -> int:
        """Return the number of touches."""
        return len(self.images)

    @property
    def size_px(self) -> tuple[int, int]:
        """Width and height of the images."""
        return self.images.shape[2], self.images.shape[1]

    def unsaturated_shares(self) -> Float64:
        """Return the share of the pixels of each image (N,) that are not saturated."""
        return np.array([unsaturated(image).mean() for image in self.images])

    def chosen(self, touches: Int64) -> Recordings:
        """Return some of the touches, by their numbers."""
        own = {name: getattr(self, name)[touches] for name in ("images", "object_ids", "object_poses")}
        names = tuple(self.names[touch] for touch in touches)
        sensor_m = None if self.sensor_m is None else self.sensor_m[touches]
        return replace(self, **own, names=names, sensor_m=sensor_m)

    def gel_at_rest(self) -> Float32:
        """Return the mean of the images without contact, or the median of the touches, (H, W, 3), levels."""
        if self.backgrounds.size:
            return np.asarray(self.backgrounds.mean(axis=0), np.float32)
        # A row at a time: a copy of all images would double the memory.
        rows = [np.median(self.images[:, row], axis=0) for row in range(self.images.shape[1])]
        return np.asarray(rows, np.float32)

    def without_heights(self) -> Recordings:
        """Return the touches without the heights of the sensor, which a fit then finds."""
        assert self.sensor_m is not None, "heights were stated"
        return replace(self, sensor_m=np.column_stack([self.sensor_m[:, :2], np.full(len(self), np.nan)]))

    def mesh(self, object_id: int) -> Mesh:
        """Return a solid."""
        return Mesh.of(self.solids[object_id])

    def poses_on_solids(self, turn_rad: Float64 | None = None) -> Float64 | None:
        """Return the point of each solid under the sensor, x and y, metres, and the turn, radians; (N, 3).

        ``turn_rad`` (N,) are turns in place of the stated ones.
        """
        if self.sensor_m is None:
            return None
        assert self.object_poses is not None, "set when the recordings are made"
        x_m, y_m = (self.sensor_m[:, :2] - self.object_poses[:, :2]).T
        turn = self.object_poses[:, 2] if turn_rad is None else turn_rad
        cosine = np.cos(turn)
        sine = np.sin(turn)
        return np.stack([cosine * x_m + sine * y_m, cosine * y_m - sine * x_m, turn], axis=1)


def _require_images(images: AnyArray, name: str) -> None:
    require_images(images, name)
    shape = images.shape
    if min(shape[1:3]) < _MIN_PX or shape[1] * shape[2] > MAX_IMAGE_PIXELS or images.nbytes > _MAX_BYTES:
        raise InputError(
            f"{name} are {shape[0]} images of {shape[2]} x {shape[1]} pixels; expected at least "
            f"{_MIN_PX} pixels a side and at most {_MAX_BYTES >> 20} MiB in all",
            next="scale the images, or take fewer",
        )


def _checked_poses(values: AnyArray, count: int, name: str, allows_nan: tuple[int, ...]) -> Float64:
    poses = real_array(values)
    if poses is None or poses.shape != (count, 3):
        raise InputError(f"{name} is {shown(values)}; expected numbers of the shape ({count}, 3)")
    checked = np.delete(poses, allows_nan, axis=1)
    if not np.isfinite(checked).all() or np.isinf(poses).any():
        raise InputError(f"{name} holds values that are not finite")
    return poses
