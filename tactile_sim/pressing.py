"""The sensor, poses, and pressing the gel onto a solid: how deep each pixel lies, and where the sensor stops.

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
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from tactile_toolkit.arithmetic import cosine_sine
from tactile_toolkit.array_types import AnyArray, Float32, Float64, Int32
from tactile_toolkit.builtin_values import is_integer, to_builtin, to_builtin_number
from tactile_toolkit.cache import MemoryCache
from tactile_toolkit.checked_fields import check_fields, real
from tactile_toolkit.errors import InputError
from tactile_toolkit.mesh import Mesh, MeshLike, as_mesh, check_manifold, merge_equal_vertices
from tactile_toolkit.touch import MAX_IMAGE_PIXELS, PRESS_DEPTH_M

CELL_M = (0.12, 0.12)
"""Width and depth of the plate that objects lie on, metres (`tactile-mnist` 0.13.0, ``CELL_SIZE``)."""

_SURFACE_M = (0.01888, 0.01416)  # tactile-mnist 0.13.0, GELSIGHT_MINI_SENSOR_SURFACE_SIZE
_GEL_M = 0.00425  # tactile-mnist 0.13.0, GELSIGHT_MINI_GEL_THICKNESS_MM

MESA_SAMPLE_PX = (-0.125, -0.375)
"""Where a pixel of the published environments looks, with Mesa 22.3.6 (llvmpipe, 4 samples): the first of its
samples, pixels from the centre, x right and y up. It belongs to the graphics driver."""


@dataclass(frozen=True, slots=True)
class Sensor:
    """A camera behind a gel that is pressed onto objects.

    Attributes
    ----------
    size_px : tuple of int
        Width and height of the image, pixels.
    window_m : tuple of float
        Width and height of what the image shows, metres; width along x of the gel's frame, height along y.
    gel_m : float
        Thickness of the gel, metres: what lies deeper does not touch it.
    press_m : float
        How far the highest point under the gel is pressed into it, metres; less than the thickness.
    sample_px : tuple of float
        Where in a pixel the surface is sampled, pixels from its centre, x right and y up.

    Raises
    ------
    InputError
        An invalid number: not finite, not positive, a press deeper than the gel.
    """

    size_px: tuple[int, int]
    window_m: tuple[float, float] = real(_SURFACE_M, above=0, most=1, many=2)
    gel_m: float = real(_GEL_M, above=0, most=0.1)
    press_m: float = real(PRESS_DEPTH_M, above=0)
    sample_px: tuple[float, float] = real((0.0, 0.0), -0.5, 0.5, many=2)

    def __post_init__(self) -> None:
        size = to_builtin(self.size_px)
        if not (isinstance(size, tuple) and len(size) == 2 and is_integer(*size) and min(size) >= 1):
            raise InputError(
                f"size of the image is {self.size_px!r}; expected width and height in whole pixels"
            )
        if size[0] * size[1] > MAX_IMAGE_PIXELS:
            raise InputError(
                f"size of the image is {size[0]} x {size[1]}; expected at most {MAX_IMAGE_PIXELS:,} pixels"
            )
        object.__setattr__(self, "size_px", size)
        check_fields(self, "the sensor")
        if not self.press_m < self.gel_m:
            raise InputError(
                f"press_m of the sensor is {self.press_m!r}; expected less than gel_m, {self.gel_m!r}"
            )

    def to_dict(self) -> dict[str, Any]:
        """Return JSON values."""
        values = asdict(self).items()
        return {name: list(value) if isinstance(value, tuple) else value for name, value in values}


def full_view(width_px: int = 320, height_px: int = 240) -> Sensor:
    """Return a GelSight Mini that shows its whole surface, whatever the shape of the image.

    Parameters
    ----------
    width_px, height_px : int
        Size of the image, pixels. With another aspect than 4:3 the picture is squashed, as the published
        synthetic sets of 64 x 64 pixels are.

    Returns
    -------
    Sensor
        18.88 x 14.16 mm; pixels are sampled at their centres.
    """
    # The window stays, whatever the aspect: so are the published 64 x 64 pictures made.
    return Sensor((width_px, height_px))


def center_view(width_px: int = 64, height_px: int = 64) -> Sensor:
    """Return the sensor as the published environments show it.

    Their orthographic camera (pyrender 0.1.50) takes the width of its window from the aspect of its pixels:
    an image of 64 x 64 pixels shows 14.16 x 14.16 mm and only one of 4:3 the whole 18.88 x 14.16 mm.

    Parameters
    ----------
    width_px, height_px : int
        Size of the image, pixels.

    Returns
    -------
    Sensor
        Height 14.16 mm, square pixels, which look at :data:`MESA_SAMPLE_PX`; another graphics driver may
        look elsewhere: ``dataclasses.replace(sensor, sample_px=...)``.
    """
    checked = Sensor((width_px, height_px))
    width, height = checked.size_px
    return Sensor(checked.size_px, (_SURFACE_M[1] * width / height, _SURFACE_M[1]), sample_px=MESA_SAMPLE_PX)


_RIGID = 1e-6


def turn_quaternion(angle_rad: float) -> tuple[float, float, float, float]:
    """Return a turn about z as quaternion x, y, z, w."""
    cosine, sine = cosine_sine(angle_rad / 2)
    return (0.0, 0.0, sine, cosine)


def pose(x_m: float = 0.0, y_m: float = 0.0, z_m: float = 0.0, *, turn_rad: float = 0.0) -> Float64:
    """Return the pose of something that stands upright.

    Parameters
    ----------
    x_m, y_m, z_m : float
        Where its origin lies, metres, cell frame: origin at the middle of the plate, x right, y away, z up.
    turn_rad : float
        Turn about z, radians, counter-clockwise seen from above.

    Returns
    -------
    ndarray of float64, shape (4, 4)
        From its own frame to the cell frame. The same bytes on every machine.

    Raises
    ------
    InputError
        A number that is not finite.
    """
    for name, value in (("x_m", x_m), ("y_m", y_m), ("z_m", z_m), ("turn_rad", turn_rad)):
        if not (isinstance(value, (int, float, np.floating, np.integer)) and math.isfinite(value)):
            raise InputError(f"{name} of a pose is {value!r}; expected a finite number")
    cosine, sine = cosine_sine(float(turn_rad))
    rows = [[cosine, -sine, 0.0, x_m], [sine, cosine, 0.0, y_m], [0.0, 0.0, 1.0, z_m], [0.0, 0.0, 0.0, 1.0]]
    return np.array(rows, np.float64)


def as_matrices(value: Any, name: str) -> Float64:
    """Return poses as matrices, shape (4, 4) or (n, 4, 4).

    Takes such arrays, and whatever has them as ``matrix`` or ``as_matrix()``: the poses of `realtouch`, of
    `tactile-mnist` and of scipy. Raises InputError for anything that moves no solid body.
    """
    found: Any = value
    # scipy's transforms have `as_matrix()`, those of the published package an attribute `matrix`.
    if not isinstance(value, np.ndarray):
        if hasattr(value, "as_matrix"):
            found = value.as_matrix()
        elif hasattr(value, "matrix"):
            found = value.matrix
    try:
        matrices = np.asarray(found, np.float64)
    except (TypeError, ValueError):
        matrices = np.empty(0)
    if matrices.ndim not in (2, 3) or matrices.shape[-2:] != (4, 4) or not len(matrices):
        shape = np.shape(found) if isinstance(found, (np.ndarray, list, tuple)) else type(value).__name__
        raise InputError(
            f"{name} is {shape}; expected a pose: a matrix of shape (4, 4), or several, (n, 4, 4)"
        )
    if not np.isfinite(matrices).all():
        raise InputError(f"{name} holds NaN or infinite numbers; expected a pose of finite numbers")
    turn = matrices[..., :3, :3]
    square = (turn[..., :, None, :] * turn[..., None, :, :]).sum(axis=-1)
    rigid = np.abs(square - np.eye(3)).max() <= _RIGID and (np.linalg.det(turn) > 0).all()
    if not rigid or np.abs(matrices[..., 3, :] - [0, 0, 0, 1]).max() > _RIGID:
        raise InputError(
            f"{name} is not a rigid pose; expected a rotation and a translation, no mirror and no scale"
        )
    return matrices


def product(one: Float64, other: Float64) -> Float64:
    """Return ``one @ other`` of matrices (n, 4, 4) in a stated order of sums, which `@` does not have."""
    parts = [one[:, :, k, None] * other[:, None, k, :] for k in range(4)]
    return ((parts[0] + parts[1]) + parts[2]) + parts[3]


def inverse_times(one: Float64, other: Float64) -> Float64:
    """Return the inverses of poses ``one`` times poses ``other``, shape (n, 4, 4)."""
    inverse = np.zeros_like(one)
    inverse[:, :3, :3] = one[:, :3, :3].swapaxes(1, 2)
    x, y, z = (one[:, k, :3] * one[:, k, 3:] for k in range(3))
    inverse[:, :3, 3], inverse[:, 3, 3] = -((x + y) + z), 1.0
    return product(inverse, other)


# Printers lay 0.05 to 0.6 mm; a wrong unit is off by a thousand.
_LEAST_M, _MOST_M = 2e-5, 2e-3
_SLACK = 0.005  # of a layer: rounding must not decide whether a top at the middle of a layer is printed
_LEVEL = 1e-9  # least slope: the outline of a level face is far away, and still a finite number


def checked_layer_m(layer_m: Any) -> float:
    """Return the height of layers as Python's own number, metres; 0 for none. InputError for any other."""
    found = to_builtin_number(layer_m, float)
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

    vertices_m: Float64
    faces: Int32
    blocks_m: Float64
    layer_m: float = 0.0

    @classmethod
    def of(cls, solid: MeshLike | Pressable, *, check: bool = True, layer_m: float = 0.0) -> Pressable:
        """Check a solid and take its triangles; those of the last few solids are kept, by their content.

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

        def make() -> Pressable:
            if check:
                _require_closed(mesh)
            # The type that kernels compute in: a condition for the same bytes. A copy: the mesh may change.
            vertices = np.array(mesh.vertices_m, np.float64, order="C")
            return cls(vertices, *_face_blocks(vertices, np.asarray(mesh.faces, np.int32)), layer_m)

        return _SOLIDS.get_or_make((_digest(mesh.vertices_m), _digest(mesh.faces), check, layer_m), make)

    @property
    def foot_m(self) -> float:
        """Height of the lowest corner, metres: environments lift a solid by minus this much."""
        return float(self.vertices_m[:, 2].min())

    def layers(self, affine: Float64) -> Float64 | None:
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


def _face_blocks(vertices: Float64, faces: Int32) -> tuple[Int32, Float64]:
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


def _digest(values: AnyArray) -> tuple[str, bytes]:
    """Return what distinguishes arrays of numbers: their type and content."""
    import xxhash

    content = np.ascontiguousarray(values)
    return f"{content.dtype}{content.shape}", xxhash.xxh3_128_digest(content.tobytes())


# By content, which takes a thousandth of the time of the check: a mesh that is changed in place is another.
_SOLIDS: MemoryCache[tuple[object, ...], Pressable] = MemoryCache(
    64 << 20, lambda solid: solid.vertices_m.nbytes + solid.faces.nbytes + solid.blocks_m.nbytes
)


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

    depth_m: Float64
    image: Float32
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
        To the cell frame, metres, see :func:`tactile_sim.pose`. The sensor's height does not matter.
    sensor : Sensor, optional
        What it sees; 320 x 240 pixels of its whole surface by default.
    cell_m : tuple of float
        Width and depth of the plate, metres.

    Returns
    -------
    Pressed
        Of one touch, or of n.

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


def depth_image(depth_m: Float64, sensor: Sensor) -> Float32:
    """Scale a depth map to an image: 0 deepest in the gel, 1 no contact; any shape, float32."""
    scaled = np.minimum(depth_m, sensor.gel_m)
    # In place: a round of large pictures is no longer in the processor's cache when it is looked at again.
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
