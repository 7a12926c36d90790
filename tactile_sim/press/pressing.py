"""Pressing the gel onto a solid in its pose: how deep each pixel lies, and where the sensor stops."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence, Sized
from dataclasses import dataclass, replace
from typing import Protocol, TypeAlias, runtime_checkable

import numpy as np
from numpy.typing import ArrayLike

from tactile_sim.elastic.contact import ElasticContact, GelLoad, GelSurface
from tactile_sim.press import elastic_press
from tactile_sim.press.pressable import Pressable
from tactile_sim.press.sensors import Sensor, SensorModel, geometry_of
from tactile_sim.user_values import finite_array, real_array, shown
from tactile_toolkit.arithmetic import cosine_sine
from tactile_toolkit.errors import InputError
from tactile_toolkit.mesh import MeshLike
from tactile_toolkit.touch import CELL_M
from tactile_toolkit.value_types import Float32, Float64, Int32, UInt8

_MAX_CELL_M = 10.0
_FARTHEST = 1e3  # metres or radians of a pose; pixels of kernels are 64-bit integers
_RIGID = 1e-6  # greatest error of the entries of a rotation

Solid: TypeAlias = "MeshLike | Pressable"
"""Solids that the gel can be pressed onto."""

_PLATE_FACES: Int32 = np.array([[0, 1, 2], [0, 2, 3]], np.int32)


class HasMatrix(Protocol):
    """A pose of another library, such as those of `realtouch` and `tactile-mnist`."""

    @property
    def matrix(self) -> ArrayLike:
        """Rotation and translation, shape (4, 4) or (n, 4, 4), metres."""


@runtime_checkable
class HasAsMatrix(Protocol):
    """A pose of SciPy, ``scipy.spatial.transform.RigidTransform``."""

    def as_matrix(self) -> ArrayLike:
        """Return rotation and translation, shape (4, 4) or (n, 4, 4), metres."""


class Renderer(Protocol):
    """Optics, such as :func:`tactile_sim.make_optics` returns."""

    def render(self, depth_m: Float64, sensor: Sensor, size_px: tuple[int, int]) -> UInt8:
        """Return pictures (n, H, W, 3) of depth maps (n, h, w), metres."""


PoseLike: TypeAlias = ArrayLike | HasMatrix | HasAsMatrix
"""One pose or several, as matrices or as objects that have them."""


def turn_quaternion(angle_rad: float) -> tuple[float, float, float, float]:
    """Return a rotation about z as quaternion x, y, z, w."""
    cosine, sine = cosine_sine(angle_rad / 2)
    return (0.0, 0.0, sine, cosine)


def pose(x_m: float = 0.0, y_m: float = 0.0, z_m: float = 0.0, *, turn_rad: float = 0.0) -> Float64:
    """Return an upright pose: a position, and a rotation about z.

    Parameters
    ----------
    x_m, y_m, z_m : float
        Position of its origin, metres, cell frame: origin at the middle of the plate, x right, y away, z up.
    turn_rad : float
        Rotation about z, radians, counter-clockwise seen from above.

    Returns
    -------
    ndarray of float64, shape (4, 4)
        From its own frame to the cell frame. The same bytes on every machine.

    Raises
    ------
    InputError
        A number is not finite, or beyond 1000 metres or radians.
    """
    values = {"x_m": x_m, "y_m": y_m, "z_m": z_m, "turn_rad": turn_rad}
    x_m, y_m, z_m, turn_rad = (
        float(finite_array(value, f"{name} of a pose", (), "a number", most=_FARTHEST))
        for name, value in values.items()
    )
    cosine, sine = cosine_sine(turn_rad)
    rows = [[cosine, -sine, 0.0, x_m], [sine, cosine, 0.0, y_m], [0.0, 0.0, 1.0, z_m], [0.0, 0.0, 0.0, 1.0]]
    return np.array(rows, np.float64)


def as_matrices(value: PoseLike, name: str) -> Float64:
    """Return poses as matrices, shape (4, 4) or (n, 4, 4).

    InputError, which begins with ``name``, for anything that is not a rigid motion.
    """
    matrix = getattr(value, "matrix", value)
    # The check of a protocol takes longer than all others.
    if not isinstance(value, np.ndarray) and isinstance(value, HasAsMatrix):
        matrix = value.as_matrix()
    matrices = real_array(matrix)
    if matrices is None or matrices.shape[-2:] != (4, 4) or matrices.ndim > 3 or not matrices.size:
        raise InputError(
            f"{name} is {shown(matrix)}; expected a pose: a matrix of shape (4, 4), or several, (n, 4, 4)"
        )
    if not (np.abs(matrices) <= _FARTHEST).all():
        raise InputError(
            f"{name} holds NaN, or a number beyond {_FARTHEST:g}; expected a pose of finite numbers, metres"
        )
    turn = matrices[..., :3, :3]
    square = (turn[..., :, None, :] * turn[..., None, :, :]).sum(axis=-1)
    rigid = np.abs(square - np.eye(3)).max() <= _RIGID and (np.linalg.det(turn) > 0).all()
    if not rigid or np.abs(matrices[..., 3, :] - [0, 0, 0, 1]).max() > _RIGID:
        raise InputError(
            f"{name} is not a rigid pose; expected a rotation and a translation, no mirror and no scale"
        )
    return matrices


def pose_product(first: Float64, second: Float64) -> Float64:
    """Return ``one @ other`` of matrices (n, 4, 4) with a fixed order of sums, unlike `@`."""
    parts = [first[:, :, k, None] * second[:, None, k, :] for k in range(4)]
    return ((parts[0] + parts[1]) + parts[2]) + parts[3]


def inverse_times(first: Float64, second: Float64) -> Float64:
    """Return the inverses of poses ``one`` times poses ``other``, shape (n, 4, 4)."""
    inverse = np.zeros_like(first)
    inverse[:, :3, :3] = first[:, :3, :3].swapaxes(1, 2)
    x, y, z = (first[:, k, :3] * first[:, k, 3:] for k in range(3))
    inverse[:, :3, 3], inverse[:, 3, 3] = -((x + y) + z), 1.0
    return pose_product(inverse, second)


@dataclass(frozen=True, slots=True, eq=False)
class Pressed:
    """The result of pressing, for one touch or for n.

    Attributes
    ----------
    depth_m : ndarray of float64, shape (H, W) or (n, H, W)
        Distance from the sensor, along its axis, of the surface under each pixel, metres: ``info["depth"]``
        of the published environments, except for single pixels beyond the reach of the gel. The least value
        is ``press_m`` of the sensor. The first row is the greatest y of the gel's frame, the first column the
        least x.
    image : ndarray of float32, shape (H, W) or (n, H, W)
        The depth image of the environments: 0 deepest in the gel, 1 no contact.
    sensor_z_m : float, or ndarray of float64, shape (n,)
        Height of the sensor where it stops, metres, cell frame.
    contacts : tuple of ElasticContact
        Those of each touch of an elastic gel: maps of the window of the image, forces of the whole gel.
        ``depth_m`` is then the surface of the gel, a ``GelSurface``, greater than its thickness where it
        bulges. Empty for other gels.
    wrenches : ndarray of float64, shape (n, 6), or None
        Of :func:`press_at` with an elastic gel: see :meth:`GelState.press`.
    """

    depth_m: Float64
    image: Float32
    sensor_z_m: float | Float64
    contacts: tuple[ElasticContact, ...] = ()
    wrenches: Float64 | None = None

    @property
    def contact(self) -> ElasticContact:
        """The contact of one touch of an elastic gel; InputError if there are none or several."""
        if len(self.contacts) != 1:
            raise InputError(
                f"there are {len(self.contacts)} contacts; expected one, of one touch of an elastic gel",
                next="press with load=tactile_sim.GelLoad(force_n=5.0), or use the items of `contacts`",
            )
        return self.contacts[0]

    def render(self, optics: Renderer, sensor: Sensor, size_px: tuple[int, int]) -> UInt8:
        """Return the images of the touches, (n, H, W, 3), as optics show the gel that was pressed.

        ``sensor`` is that of the press, ``size_px`` the width and height of the images. InputError if the
        optics do not make such images.
        """
        return optics.render(self.depth_m.reshape(-1, *self.depth_m.shape[-2:]), sensor, size_px)


def render_touch(
    solid: Solid | Sequence[Solid],
    object_pose: PoseLike,
    sensor_pose: PoseLike,
    sensor: Sensor | SensorModel | None = None,
    *,
    cell_m: tuple[float, float] = CELL_M,
    load: GelLoad | None = None,
) -> Pressed:
    """Press the gel onto a solid that lies on the plate.

    The sensor comes down along its own axis. Without ``load``, it stops where the highest point under its
    pixels is ``press_m`` of the sensor away from it, as in the published environments, and the depth
    map is the solid, cut off at the surface of the gel; there is no force. An elastic gel deforms: the
    contact is solved for the whole gel, the sensor stops at a force or a depth, and the depth map is the
    surface of the gel.

    Parameters
    ----------
    solid : Mesh, record, trimesh.Trimesh, Pressable, or a sequence of them
        A closed mesh in metres; a sequence has one for each touch.
    object_pose, sensor_pose : array_like, shape (4, 4) or (n, 4, 4), or an object with such a ``matrix``
        To the cell frame, metres, see :func:`tactile_sim.pose`; also as ``RigidTransform`` of SciPy. The
        sensor's height does not matter.
    sensor : Sensor or SensorModel, optional
        The sensor; 320 x 240 pixels of its whole surface by default.
    cell_m : tuple of float
        Width and depth of the plate, metres.
    load : GelLoad, optional
        An elastic gel, the force (below 1000 N) or depth of the press, and the motion of the solid that
        follows (at most 1 mm along x and y of the gel's frame, and 10 degrees about the sensor's axis); one
        for all touches, or with numbers for each. To a force, the sensor presses at most to half the
        thickness of the gel, the limit of linear theory.

    Raises
    ------
    InputError
        A mesh is not closed, a pose is not rigid, or a sensor is off the cell or points away from it; a
        load is out of range, or its contact cannot be solved.
    """
    sensor = geometry_of(sensor)
    width_m, depth_m = finite_array(
        cell_m, "cell_m", (2,), "width and depth, metres", most=_MAX_CELL_M
    ).tolist()
    setup = _Setup.of(solid, object_pose, sensor_pose, (width_m, depth_m))
    if not isinstance(load, GelLoad | None):
        raise InputError(f"load is {shown(load)}; expected a GelLoad, such as GelLoad(force_n=5.0)")
    if load is None:
        made = _press_rigid(setup, sensor)
    else:
        made = _press_elastic(setup, elastic_press.loads_of(load, setup.count, sensor), sensor)
    sensor_z_m = setup.targets[:, 2, 3] + setup.targets[:, 2, 2] * made.sensor_z_m
    if setup.is_single:
        return Pressed(made.depth_m[0], made.image[0], float(sensor_z_m[0]), made.contacts)
    return replace(made, sensor_z_m=sensor_z_m)


@dataclass(frozen=True, slots=True, eq=False)
class _Setup:
    """Solids, their poses and the target poses of sensors (n, 4, 4), for ``count`` touches."""

    solids: Sequence[Solid]
    objects: Float64
    targets: Float64
    cell_m: tuple[float, float]
    count: int
    is_single: bool

    @classmethod
    def of(
        cls,
        solid: Solid | Sequence[Solid],
        object_pose: PoseLike,
        sensor_pose: PoseLike,
        cell_m: tuple[float, float],
    ) -> _Setup:
        objects = as_matrices(object_pose, "object_pose")
        targets = as_matrices(sensor_pose, "sensor_pose")
        is_single = not isinstance(solid, Sequence) and objects.ndim == targets.ndim == 2
        solids = solid if isinstance(solid, Sequence) else [solid]
        objects = objects.reshape(-1, 4, 4)
        targets = targets.reshape(-1, 4, 4)
        count = _count_of(solids=solids, object_poses=objects, sensor_poses=targets)
        _require_above_cell(targets, cell_m)
        return cls(solids, objects, targets, cell_m, count, is_single)


def _press_rigid(setup: _Setup, sensor: Sensor) -> Pressed:
    """Press a gel that does not deform: images show the solid. Heights are relative to the targets."""
    scene = _Scene.of(setup, sensor)
    shape = (setup.count, *sensor.size_px[::-1])
    depths_m = np.empty(shape)
    image = np.empty(shape, np.float32)
    highest_m = np.empty(setup.count)
    for touch in range(setup.count):
        scene.raise_heights(touch, depths_m[touch])
        highest_m[touch] = scene.to_depth(depths_m[touch], image[touch], sensor.press_m, sensor.gel_m)
    return Pressed(depths_m, image, highest_m + sensor.press_m)


def _press_elastic(setup: _Setup, loads: Sequence[GelLoad], sensor: Sensor) -> Pressed:
    """Press an elastic gel. Heights are relative to the targets."""
    whole = elastic_press.WholeGel.of(sensor)
    scene = _Scene.of(setup, whole.sensor)
    depths_m = np.empty((len(loads), *sensor.size_px[::-1]))
    stops_m = np.empty(len(loads))
    contacts = []
    for touch, load in enumerate(loads):
        heights_m = np.empty(whole.sensor.size_px[::-1])
        scene.raise_heights(touch, heights_m)
        contacts.append(whole.press(heights_m, load, depths_m[touch]))
        stops_m[touch] = heights_m.max() + sensor.gel_m - contacts[-1].depth_m
    return Pressed(depths_m.view(GelSurface), sensor.depth_image(depths_m), stops_m, tuple(contacts))


@dataclass(frozen=True, slots=True, eq=False)
class _Scene:
    """Solids on the plate as sensors see them: maps to pixels of the solids and of the plate, (n, 3, 4).

    The plate has ``corners_m`` (4, 3), and ``ball_m`` (1, 4) around it.
    """

    solids: list[Pressable]
    affines: Float64
    plates: Float64
    corners_m: Float64
    ball_m: Float64
    rasterise: Callable[..., None]
    to_depth: Callable[[Float64, Float32, float, float], float]

    @classmethod
    def of(cls, setup: _Setup, sensor: Sensor) -> _Scene:
        from tactile_sim.press import press_kernels

        affines = to_pixels(inverse_times(setup.targets, setup.objects), sensor)
        plates = to_pixels(inverse_times(setup.targets, np.eye(4)[None]), sensor)
        corners_m = np.array([[-1, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0]]) * [*setup.cell_m, 0.0] / 2
        ball_m = np.array([[0.0, 0.0, 0.0, max(setup.cell_m)]])
        solids = [Pressable.of(solid) for solid in setup.solids]
        kernels = press_kernels.rasterise, press_kernels.to_depth
        return cls(solids, affines, plates, corners_m, ball_m, *kernels)

    def raise_heights(self, touch: int, out: Float64) -> None:
        """Write the heights under the pixels of one touch, metres along the sensor's axis."""
        out.fill(-2 * self.ball_m[0, 3])  # far end of the camera, beyond object and plate
        plate = self.plates[touch % len(self.plates)]
        self.rasterise(out, self.corners_m, _PLATE_FACES, self.ball_m, plate, None)
        here = self.solids[touch % len(self.solids)]
        affine = self.affines[touch % len(self.affines)]
        self.rasterise(out, here.vertices_m, here.faces, here.blocks_m, affine, here.layers(affine))


def _count_of(**arguments: Sized) -> int:
    """Return the number of touches; each argument has one item for each touch, or one for all."""
    count = max(map(len, arguments.values()))
    for name, values in arguments.items():
        if len(values) not in (1, count):
            what = name.replace("_", " ")
            raise InputError(f"{len(values)} {what} for {count} touches; expected 1 or {count}")
    return count


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


def to_pixels(poses: Float64, sensor: Sensor) -> Float64:
    """Return maps from a body's frame to column, row from the bottom, and height; shape (n, 3, 4)."""
    affine = poses[:, :3].copy()
    for axis in range(2):
        affine[:, axis] *= sensor.size_px[axis] / sensor.window_m[axis]
        # Pixel 0 samples a point that is half a pixel, plus the offset of the sample, from the edge.
        affine[:, axis, 3] += sensor.size_px[axis] / 2 - 0.5 - sensor.sample_px[axis]
    return affine
