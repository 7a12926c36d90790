"""Pressing the gel onto a solid: how deep each pixel lies, and where the sensor stops."""

from __future__ import annotations

import math
from collections.abc import Sequence, Sized
from dataclasses import dataclass
from typing import Any

import numpy as np

from tactile_sim.poses import as_matrices, inverse_times
from tactile_sim.pressable import Pressable
from tactile_sim.sensor import Sensor, full_view
from tactile_sim.sensor_models import SensorModel
from tactile_toolkit.array_types import Float32, Float64, Int32
from tactile_toolkit.errors import InputError
from tactile_toolkit.mesh import MeshLike
from tactile_toolkit.touch import CELL_M

_PLATE_FACES: Int32 = np.array([[0, 1, 2], [0, 2, 3]], np.int32)


@dataclass(frozen=True, slots=True, eq=False)
class Pressed:
    """The result of pressing, for one touch or for n.

    Attributes
    ----------
    depth_m : ndarray of float64, shape (H, W) or (n, H, W)
        Distance from the sensor, along its axis, of the surface under each pixel, metres: ``info["depth"]``
        of the published environments, except for single pixels beyond the reach of the gel. The least value
        is the press depth. The first row is the greatest y of the gel's frame, the first column the least x.
    image : ndarray of float32, shape (H, W) or (n, H, W)
        The depth image of the environments: 0 deepest in the gel, 1 no contact.
    sensor_z_m : float, or ndarray of float64, shape (n,)
        Height of the sensor where it stops, metres, cell frame.
    """

    depth_m: Float64
    image: Float32
    sensor_z_m: float | Float64


def render_touch(
    solid: MeshLike | Pressable | Sequence[MeshLike | Pressable],
    object_pose: Any,
    sensor_pose: Any,
    sensor: Sensor | SensorModel | None = None,
    *,
    cell_m: tuple[float, float] = CELL_M,
) -> Pressed:
    """Press the gel onto a solid that lies on the plate.

    The sensor comes down along its own axis until the highest point under its pixels is pressed into the gel
    by the press depth, as the published environments define it; there is no force and no motion of the solid.

    Parameters
    ----------
    solid : Mesh, record, trimesh.Trimesh, Pressable, or a sequence of them
        A closed mesh in metres; a sequence has one for each touch.
    object_pose, sensor_pose : array_like, shape (4, 4) or (n, 4, 4), or an object with ``matrix``
        To the cell frame, metres, see :func:`tactile_sim.pose`. The sensor's height does not matter.
    sensor : Sensor or SensorModel, optional
        The sensor; 320 x 240 pixels of its whole surface by default.
    cell_m : tuple of float
        Width and depth of the plate, metres.

    Returns
    -------
    Pressed
        Of one touch, or of n.

    Raises
    ------
    InputError
        A mesh is not closed, a pose is not rigid, or a sensor is off the cell or points away from it.
    """
    # Importing numba takes half a second.
    from tactile_sim.press_kernels import rasterise, to_depth

    sensor = sensor or full_view()
    if isinstance(sensor, SensorModel):
        sensor = sensor.sensor
    objects, targets = as_matrices(object_pose, "object_pose"), as_matrices(sensor_pose, "sensor_pose")
    solids: list[Any] = list(solid) if isinstance(solid, (list, tuple)) else [solid]
    is_single = not isinstance(solid, (list, tuple)) and objects.ndim == targets.ndim == 2
    objects, targets = objects.reshape(-1, 4, 4), targets.reshape(-1, 4, 4)
    count = _count_of(solids=solids, object_poses=objects, sensor_poses=targets)
    prepared = [Pressable.of(each) for each in solids]
    _require_above_cell(targets, cell_m)
    shape = (count, *sensor.size_px[::-1])
    depth_m, image, highest_m = np.empty(shape), np.empty(shape, np.float32), np.empty(count)
    affines = _to_pixels(inverse_times(targets, objects), sensor)
    plates = _to_pixels(inverse_times(targets, np.eye(4)[None]), sensor)
    corners_m = np.array([[-1, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0]]) * [*cell_m, 0.0] / 2
    ball_m = np.array([[0.0, 0.0, 0.0, max(cell_m)]])
    for touch in range(count):
        out = depth_m[touch]
        out.fill(-2 * max(cell_m))  # far end of the camera, beyond object and plate
        rasterise(out, corners_m, _PLATE_FACES, ball_m, plates[touch % len(plates)], None)
        here, affine = prepared[touch % len(prepared)], affines[touch % len(affines)]
        rasterise(out, here.vertices_m, here.faces, here.blocks_m, affine, here.layers(affine))
        highest_m[touch] = to_depth(out, image[touch], sensor.press_m, sensor.gel_m)
    sensor_z_m = targets[:, 2, 3] + targets[:, 2, 2] * (highest_m + sensor.press_m)
    if is_single:
        return Pressed(depth_m[0], image[0], float(sensor_z_m[0]))
    return Pressed(depth_m, image, sensor_z_m)


def _count_of(**given: Sized) -> int:
    """Return the number of touches: of each argument there are as many, or one for all."""
    count = max(map(len, given.values()))
    for name, each in given.items():
        if len(each) not in (1, count):
            what = name.replace("_", " ")
            raise InputError(f"{len(each)} {what} for {count} touches; expected 1 or {count}")
    return count


def depth_image(depth_m: Float64, sensor: Sensor) -> Float32:
    """Scale a depth map to an image: 0 deepest in the gel, 1 no contact; any shape, float32."""
    scaled = np.minimum(depth_m, sensor.gel_m)
    # In place: a round of large pictures does not stay in the processor's cache.
    np.maximum(scaled, sensor.press_m, out=scaled)
    scaled -= sensor.press_m
    scaled /= sensor.gel_m - sensor.press_m
    return scaled.astype(np.float32)


def _require_above_cell(targets: Float64, cell_m: tuple[float, float]) -> None:
    off = (np.abs(targets[:, :2, 3]) > np.array(cell_m) / 2).any(axis=1) | ~(targets[:, 2, 2] > 0)
    if not off.any():
        return
    touch = int(np.argmax(off))
    x_mm, y_mm = 1e3 * targets[touch, :2, 3]
    tilt = math.degrees(math.acos(float(np.clip(targets[touch, 2, 2], -1, 1))))
    raise InputError(
        f"sensor_pose {touch} is at x {x_mm:.1f} mm, y {y_mm:.1f} mm, its axis {tilt:.0f} degrees from the "
        f"vertical; expected a place above the cell of {1e3 * cell_m[0]:.0f} x {1e3 * cell_m[1]:.0f} mm and "
        "a sensor that looks down (its z axis points up)"
    )


def _to_pixels(seen: Float64, sensor: Sensor) -> Float64:
    """Return maps from a body's frame to column, row from the bottom, and height; shape (n, 3, 4)."""
    affine = seen[:, :3].copy()
    for axis in range(2):
        affine[:, axis] *= sensor.size_px[axis] / sensor.window_m[axis]
        # Pixel 0 looks at its sample point: half a pixel, and the sample's own place, from the edge.
        affine[:, axis, 3] += sensor.size_px[axis] / 2 - 0.5 - sensor.sample_px[axis]
    return affine
