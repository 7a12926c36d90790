"""Bodies that a gel in a moving world can touch, and their heights over its pixels."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple, TypeAlias

import numpy as np

from tactile_sim.elastic.contact import pixel_positions_m
from tactile_sim.press.pressable import Pressable
from tactile_sim.press.pressing import to_pixels
from tactile_sim.press.sensors import Sensor
from tactile_toolkit import checked_fields
from tactile_toolkit.errors import InputError
from tactile_toolkit.mesh import MeshLike
from tactile_toolkit.value_types import Float64, Int32

SIZES = {"sphere": 1, "capsule": 2, "cylinder": 2, "ellipsoid": 3, "box": 3, "plane": 0}
"""Number of sizes of each kind of shape."""

_KERNEL_KINDS = {"sphere": 0, "ellipsoid": 0, "cylinder": 1, "capsule": 2, "box": 3, "plane": 4}
_MAX_M = 1e3


@dataclass(frozen=True, slots=True)
class Shape:
    """A body whose surface is known in closed form; names and sizes are those of MuJoCo.

    Attributes
    ----------
    kind : str
        ``"sphere"``, ``"capsule"``, ``"cylinder"``, ``"ellipsoid"``, ``"box"`` or ``"plane"``. The axis of
        capsules and cylinders is z; a plane is the half-space below its x-y plane.
    size_m : tuple of float
        Metres: the radius of a sphere; radius and half length of a capsule, without its ends, or cylinder;
        three half lengths of an ellipsoid or box; none of a plane.

    Raises
    ------
    InputError
        The kind is unknown, or sizes are missing or not positive.
    """

    kind: str
    size_m: tuple[float, ...] = ()

    def __post_init__(self) -> None:
        if not isinstance(self.kind, str) or self.kind not in SIZES:
            raise InputError(f"is {self.kind!r}; expected one of {', '.join(SIZES)}", field="kind")
        size = checked_fields.to_builtin(self.size_m, float)
        count = SIZES[self.kind]
        is_size = isinstance(size, tuple) and len(size) == count
        if not is_size or not all(isinstance(half, float) and 0 < half <= _MAX_M for half in size):
            raise InputError(
                f"of a {self.kind} is {self.size_m!r}; expected {count} numbers above 0, metres",
                field="size_m",
            )
        object.__setattr__(self, "size_m", size)

    @property
    def half_m(self) -> Float64:
        """Half sizes along x, y and z, metres; without the ends of a capsule."""
        if self.kind in ("capsule", "cylinder"):
            return np.array([self.size_m[0], *self.size_m])
        return np.resize(np.array(self.size_m or (_MAX_M,)), 3)

    @property
    def blocks_m(self) -> Float64:
        """A ball around it, shape (1, 4), centre and radius, metres."""
        reach_m = {"sphere": self.size_m[:1], "capsule": (sum(self.size_m),), "plane": (math.inf,)}
        return np.array([[0.0, 0.0, 0.0, math.hypot(*reach_m.get(self.kind, self.half_m))]])


Body: TypeAlias = "MeshLike | Pressable | Shape"
"""What a gel in a moving world can touch."""


def checked_body(solid: Body) -> Pressable | Shape:
    """Return a body in the form that kernels take; InputError for anything that is no body."""
    return solid if isinstance(solid, Shape) else Pressable.of(solid)


class PixelGrid(NamedTuple):
    """Positions of the pixels of a map in the frame of the gel: x of columns and y of rows, metres."""

    columns_m: Float64
    rows_m: Float64

    @classmethod
    def of(cls, sensor: Sensor, block_px: int = 1) -> PixelGrid:
        """Return the positions where a sensor samples its pixels, or the middles of blocks of them."""
        width_m, height_m = sensor.pixel_m
        shape = (sensor.size_px[1] // block_px, sensor.size_px[0] // block_px)
        columns_m, rows_m = pixel_positions_m(shape, (block_px * width_m, block_px * height_m))
        return cls(columns_m + sensor.sample_px[0] * width_m, rows_m.ravel() + sensor.sample_px[1] * height_m)


def raise_bodies(
    bodies: Sequence[Pressable | Shape], poses: Float64, sensor: Sensor
) -> tuple[Float64, Int32]:
    """Return the heights of bodies over the pixels of a gel, and which body is the highest.

    Parameters
    ----------
    bodies : sequence of Pressable or Shape
        What may be there.
    poses : ndarray of float64, shape (n, 4, 4)
        From their frames to that of the gel.
    sensor : Sensor
        Pixels, and the thickness of the gel: higher points are behind it and do not count.

    Returns
    -------
    heights_m : ndarray of float64, shape (H, W)
        Above the surface of the gel at rest, metres; -inf where there is no body.
    owners : ndarray of int32, shape (H, W)
        Index of the highest body; -1 for none.
    """
    from tactile_sim.loop import loop_kernels
    from tactile_sim.press.press_kernels import rasterise

    shape = sensor.size_px[::-1]
    grid = PixelGrid.of(sensor)
    heights_m = np.full(shape, -np.inf)
    owners = np.full(shape, -1, np.int32)
    reach_m = (sensor.window_m[0] / 2, sensor.window_m[1] / 2, sensor.gel_m)
    affines = to_pixels(poses, sensor)
    for index, body in enumerate(bodies):
        if not loop_kernels.is_near(body.blocks_m, poses[index], reach_m):
            continue
        body_m = np.full(shape, -np.inf)
        if isinstance(body, Shape):
            loop_kernels.raise_shape(body_m, _KERNEL_KINDS[body.kind], body.half_m, poses[index], *grid)
        else:
            layers = body.layers(affines[index])
            solid = (body.vertices_m, body.faces, body.blocks_m)
            # A hollow body may have a wall on either side of the gel.
            rasterise(body_m, *solid, affines[index], layers, sensor.gel_m)
        is_highest = (body_m > heights_m) & (body_m <= sensor.gel_m)
        np.copyto(heights_m, body_m, where=is_highest)
        owners[is_highest] = index
    return heights_m, owners
