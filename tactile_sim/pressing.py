"""Pressing the gel onto a solid: how deep each pixel lies, and how high the sensor stops.

Solids are felt as they are modelled, or with the surface that a printer makes of them, in closed form. A
printer of molten plastic lays a solid down from its foot, flat side down, in layers of one height. Each has
the outline of the solid at its middle, and its edge bulges as a half circle. Where the solid is about plane,
its section across the contour lines is a row of half-infinite bars with round ends, one on another; what the
gel feels at a point is where the line of sight straight up through that point leaves them: one quadratic
equation. So a printed solid stands as it was printed, and is felt from above.

What follows from that: a layer is printed where the solid reaches its middle, as slicers decide; tops end at
an integer of layers; edges of faces that meet at an angle are rounded by the slope of each face alone.
Bridges, seams, strings and the lines inside of a layer are not made.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tactile_sim.sensor import CELL_M, Sensor, as_matrices, full_view, inverse_times
from tactile_toolkit.errors import InputError
from tactile_toolkit.mesh.files import merge_equal_vertices
from tactile_toolkit.mesh.mesh import Mesh, MeshLike, as_mesh
from tactile_toolkit.mesh.solid_check import check_manifold
from tactile_toolkit.wording import plain_number

Numbers = NDArray[np.float64]

# Printers lay 0.05 to 0.6 mm; a wrong unit is off by a thousand.
_LEAST_M, _MOST_M = 2e-5, 2e-3
_SLACK = 0.005  # of a layer: rounding must not decide whether a top at the middle of a layer is printed
_LEVEL = 1e-9  # least slope: the outline of a level face is far away, and still a finite number


def checked_layer_m(layer_m: Any) -> float:
    """Return the height of layers as Python's own number, metres; 0 for none. InputError for any other."""
    found = plain_number(layer_m, float)
    if isinstance(found, float) and (found == 0 or _LEAST_M <= found <= _MOST_M):
        return found
    raise InputError(
        f"layers are {layer_m!r} m high; expected {_LEAST_M} to {_MOST_M} m, such as 0.0002, or 0 for none"
    )


_HARMLESS = (None, "overlap")  # bodies that run into one another are felt as one

_PLATE_FACES = np.array([[0, 1, 2], [0, 2, 3]], np.int32)

# Runs of 16 to 64 are alike: a touch of a digit takes 0.10 ms, and 0.24 where all its faces are looked at (64
# x 64, one core).
_FACES_PER_BLOCK = 32
# A seventh of the window; of a digit about as many faces as a run lie in each.
_CELL_OF_FACES_M = 0.002


@dataclass(frozen=True, slots=True, eq=False)
class Pressable:
    """A solid that was checked once, so that it can be pressed many times.

    Attributes
    ----------
    vertices_m : ndarray of float64, shape (V, 3)
        Corners, metres, in the solid's own frame.
    faces : ndarray of int32, shape (F, 3)
        Triangles, counter-clockwise seen from outside.
    blocks_m : ndarray of float64, shape (B, 4)
        Balls around runs of neighbouring triangles: centre and radius, metres.
    layer_m : float
        Height of the layers in which a printer lays the solid down, from its lowest corner along its own z
        axis, metres; 0 where its surface is smooth.
    """

    vertices_m: NDArray[np.float64]
    faces: NDArray[np.int32]
    blocks_m: NDArray[np.float64]
    layer_m: float = 0.0

    @classmethod
    def of(cls, solid: MeshLike | Pressable, *, check: bool = True, layer_m: float = 0.0) -> Pressable:
        """Check a solid and take its triangles.

        Parameters
        ----------
        solid : Mesh, record of a data set, or trimesh.Trimesh
            In metres.
        check : bool
            Set to False only for meshes that are known to be closed.
        layer_m : float
            Press onto the solid as it is printed: in layers of this height with rounded edges, metres,
            0.00002 to 0.002 (rounded, as a printer lays them). 0, the default: as it is modelled.

        Returns
        -------
        Pressable

        Raises
        ------
        InputError
            The mesh is open, inside out, flat, or has corners that are not numbers; layers of another height.
        """
        # Prepared already: its layers are its own.
        if isinstance(solid, Pressable):
            return solid
        layer_m = checked_layer_m(layer_m)
        mesh = as_mesh(solid)
        if check:
            _require_closed(mesh)
        # The type that kernels compute in: a condition for the same bytes.
        vertices = np.ascontiguousarray(mesh.vertices_m, np.float64)
        return cls(vertices, *_face_blocks(vertices, np.asarray(mesh.faces, np.int32)), layer_m)

    @property
    def foot_m(self) -> float:
        """Height of the lowest corner, metres: environments lift a solid by minus this much."""
        return float(self.vertices_m[:, 2].min())

    def layers(self, affine: NDArray[np.float64]) -> NDArray[np.float64] | None:
        """Return what the kernels need of the layers, seen through a map; InputError for one that leans.

        0: height of a layer; 1: how far below its middle its outline is taken; 2: number of layers; 3: what,
        added to a height, gives that over the foot; 4: least slope.
        """
        if not self.layer_m:
            return None
        if tuple(affine[2, :3]) != (0.0, 0.0, 1.0):
            raise InputError(
                "layers of a print were asked for, and the solid leans, or the sensor; expected both upright",
                next="layer_m=0",
            )
        foot_m, slack_m = self.foot_m, _SLACK * self.layer_m
        top_m = float(self.vertices_m[:, 2].max())
        count = np.floor((top_m - foot_m + slack_m) / self.layer_m - 0.5) + 1
        return np.array([self.layer_m, slack_m, count, -affine[2, 3] - foot_m, _LEVEL])


def _face_blocks(
    vertices: NDArray[np.float64], faces: NDArray[np.int32]
) -> tuple[NDArray[np.int32], NDArray[np.float64]]:
    """Sort faces so that neighbours lie together; return them and a ball around each run of about 32.

    Most of a solid is outside the window of a touch: whole runs are left out by one test.
    """
    # Corner by corner throughout: numpy reduces over an axis of three many times slower.
    first, second, third = (vertices[faces[:, k]] for k in range(3))
    middles = (first[:, :2] + second[:, :2] + third[:, :2]) / 3
    cells = np.floor((middles - vertices[:, :2].min(axis=0)) / _CELL_OF_FACES_M).astype(np.int64)
    one, other = second - first, third - first
    # Faces that look down are never felt: kept apart, they make the balls of the others smaller.
    down = one[:, 0] * other[:, 1] - one[:, 1] * other[:, 0] <= 0
    order = np.lexsort((cells[:, 0], cells[:, 1], down))
    corners = [each[order] for each in (first, second, third)]
    # Runs of one length, the last one shorter: the kernel knows from their number where each begins.
    count = -(-len(faces) // _FACES_PER_BLOCK)
    per_block = -(-len(faces) // count)
    starts = np.arange(0, len(faces), per_block)
    low, high = (
        each.reduceat(each(each(corners[0], corners[1]), corners[2]), starts)
        for each in (np.minimum, np.maximum)
    )
    centre = (low + high) / 2
    around = np.repeat(centre, per_block, axis=0)[: len(faces)]
    x, y, z = ((corner - around).T for corner in corners)
    far = np.maximum(np.maximum((x * x).sum(axis=0), (y * y).sum(axis=0)), (z * z).sum(axis=0))
    blocks = np.column_stack([centre, np.sqrt(np.maximum.reduceat(far, starts))])
    return np.ascontiguousarray(faces[order]), blocks


def _require_closed(mesh: Mesh) -> None:
    verdict = check_manifold(mesh)
    if verdict.problem == "not-manifold":
        # Published digits repeat corners; what counts is whether the surface is closed in space.
        merged = Mesh(*merge_equal_vertices(np.asarray(mesh.vertices_m, np.float64), mesh.faces))
        verdict = check_manifold(merged)
    if verdict.problem not in _HARMLESS:
        mend = "repair it, `mnist3d validate FILE` names the problem"
        if verdict.problem == "no-volume":
            mend = "look at its unit: metres in Python, millimetres in files but GLB; or repair it"
        raise InputError(
            f"the mesh bounds no solid ({verdict.problem}: {verdict.detail}); a gel can be pressed onto "
            f"closed meshes only",
            next=mend,
        )


@dataclass(frozen=True, slots=True, eq=False)
class Pressed:
    """The result of pressing, for one touch or for n.

    Attributes
    ----------
    depth_m : ndarray of float64, shape (H, W) or (n, H, W)
        Distance from the sensor, along its axis, of the surface under each pixel, metres: ``info["depth"]``
        of the published environments, but for single pixels beyond the reach of the gel. The least value is
        the press depth. The first row is the greatest y of the gel's frame, the first column the least x.
    image : ndarray of float32, shape (H, W) or (n, H, W)
        The depth image of the environments: 0 deepest in the gel, 1 no contact.
    sensor_z_m : float, or ndarray of float64, shape (n,)
        Height of the sensor where it stops, metres, cell frame.
    """

    depth_m: NDArray[np.float64]
    image: NDArray[np.float32]
    sensor_z_m: Any


def render_touch(
    solid: MeshLike | Pressable | Sequence[MeshLike | Pressable],
    object_pose: Any,
    sensor_pose: Any,
    sensor: Sensor | None = None,
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
        From the solid's frame to the cell frame, metres, see :func:`tactile_sim.pose`. And where the sensor
        is sent: its z axis points away from the plate, and its height does not matter.
    sensor : Sensor, optional
        What it sees; 320 x 240 pixels of its whole surface by default.
    cell_m : tuple of float
        Width and depth of the plate, metres.

    Returns
    -------
    Pressed
        Of one touch where both poses are single, else of n.

    Raises
    ------
    InputError
        A mesh that is not closed, poses that are not rigid, a sensor off the cell or pointing away from it.
    """
    from tactile_sim.kernels import rasterise, to_depth

    sensor = full_view() if sensor is None else sensor
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
        out.fill(-2 * max(cell_m))  # where there is neither object nor plate: the far end of the camera
        rasterise(out, corners_m, _PLATE_FACES, ball_m, plates[touch % len(plates)], None)
        here, affine = prepared[touch % len(prepared)], affines[touch % len(affines)]
        rasterise(out, here.vertices_m, here.faces, here.blocks_m, affine, here.layers(affine))
        highest_m[touch] = to_depth(out, image[touch], sensor.press_m, sensor.gel_m)
    sensor_z_m = targets[:, 2, 3] + targets[:, 2, 2] * (highest_m + sensor.press_m)
    if is_single:
        return Pressed(depth_m[0], image[0], float(sensor_z_m[0]))
    return Pressed(depth_m, image, sensor_z_m)


def _count_of(**given: Any) -> int:
    """Return how many touches are meant: things of each kind are as many, or one for all."""
    count = max(map(len, given.values()))
    for name, each in given.items():
        if len(each) not in (1, count):
            what = name.replace("_", " ")
            raise InputError(f"{len(each)} {what} for {count} touches; expected 1 or {count}")
    return count


def depth_image(depth_m: NDArray[np.float64], sensor: Sensor) -> NDArray[np.float32]:
    """Scale a depth map to an image: 0 deepest in the gel, 1 no contact; any shape, float32."""
    scaled = np.minimum(depth_m, sensor.gel_m)
    # In place: a round of large pictures is no longer in the processor's cache when it is looked at again.
    np.maximum(scaled, sensor.press_m, out=scaled)
    scaled -= sensor.press_m
    scaled /= sensor.gel_m - sensor.press_m
    return scaled.astype(np.float32)


def _require_above_cell(targets: NDArray[np.float64], cell_m: tuple[float, float]) -> None:
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


def _to_pixels(seen: NDArray[np.float64], sensor: Sensor) -> NDArray[np.float64]:
    """Return maps from a body's frame to column, row from the bottom, and height; shape (n, 3, 4)."""
    affine = seen[:, :3].copy()
    for axis in range(2):
        affine[:, axis] *= sensor.size_px[axis] / sensor.window_m[axis]
        # Pixel 0 looks at its sample point: half a pixel, and the sample's own place, from the edge.
        affine[:, axis, 3] += sensor.size_px[axis] / 2 - 0.5 - sensor.sample_px[axis]
    return affine
