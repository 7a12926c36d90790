"""Solids that the gel can be pressed onto: closed meshes, sorted for the kernels, smooth or printed.

A printed surface is made in closed form. A printer of molten plastic lays a solid down from its foot, flat
side down, in layers of one height. Each layer has the outline of the solid at its middle, and its edge bulges
as a half circle. Where the solid is about plane, its section across the contour lines is a row of half-
infinite bars with round ends, one on another. The gel feels the point where the vertical line of sight leaves
them: one quadratic equation. A printed solid therefore stands as it was printed and is felt from above.

Consequences: a layer is printed where the solid reaches its middle, as slicers decide; tops end at an integer
number of layers; edges of faces that meet at an angle are rounded by the slope of each face alone. Bridges,
seams, strings and the lines inside a layer are not modelled.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import xxhash

from tactile_toolkit import cache, checked_fields
from tactile_toolkit.errors import InputError
from tactile_toolkit.mesh import Mesh, MeshLike, check_manifold
from tactile_toolkit.value_types import AnyArray, Float64, Int32

# Layers of printers have 0.05 to 0.6 mm; a wrong unit gives a factor of 1,000.
_MIN_LAYER_M, _MAX_LAYER_M = 2e-5, 2e-3
_SLACK = 0.005  # of a layer: rounding must not decide whether a top at the middle of a layer is printed
_LEVEL = 1e-9  # least slope: the outline of a level face is far away, and still a finite number
_HARMLESS = (None, "overlap")  # bodies that intersect are felt as one

# Runs of 16 to 64 are alike: a touch of a digit takes 0.10 ms, and 0.24 ms without runs (64 x 64, one core).
_FACES_PER_BLOCK = 32

# A seventh of the window; each cell of a digit holds about as many faces as a run.
_CELL_OF_FACES_M = 0.002
_CACHE_BYTES = 64 << 20


def checked_layer_m(layer_m: object) -> float:
    """Return the height of layers as a Python float, metres; 0 for none. InputError for other values."""
    height_m = checked_fields.to_builtin(layer_m, float)
    if isinstance(height_m, float) and (height_m == 0 or _MIN_LAYER_M <= height_m <= _MAX_LAYER_M):
        return height_m
    raise InputError(
        f"is {layer_m!r} m; expected {_MIN_LAYER_M} to {_MAX_LAYER_M} m, such as 0.0002, or 0 for none",
        field="layer_m",
    )


@dataclass(frozen=True, slots=True, eq=False)
class Pressable:
    """A checked solid that can be pressed many times.

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
        """Check a solid and sort its triangles; those of the last few solids are kept, by their content.

        Parameters
        ----------
        solid : Mesh, record of a data set, or trimesh.Trimesh
            In metres.
        check : bool
            Set to False only for meshes that are known to be closed.
        layer_m : float
            Height of the rounded layers in which a printer lays the solid down, metres, 0.00002 to 0.002; 0
            for a solid as it is modelled.

        Returns
        -------
        Pressable

        Raises
        ------
        InputError
            The mesh is open, inside out or flat, or has corners that are not finite; the layers have another
            height.
        """
        if isinstance(solid, Pressable):  # with layers of its own
            return solid
        layer_m = checked_layer_m(layer_m)
        mesh = Mesh.of(solid)

        def make() -> Pressable:
            if check:
                _require_closed(mesh)
            # The type that kernels compute in, for the same bytes. A copy, because the mesh may change.
            vertices = np.array(mesh.vertices_m, np.float64, order="C")
            return cls(vertices, *_face_blocks(vertices, np.asarray(mesh.faces, np.int32)), layer_m)

        return _SOLIDS.get_or_make((_digest(mesh.vertices_m), _digest(mesh.faces), check, layer_m), make)

    @property
    def foot_m(self) -> float:
        """Height of the lowest corner, metres: environments lift a solid by minus this much."""
        return float(self.vertices_m[:, 2].min())

    def layers(self, affine: Float64) -> Float64 | None:
        """Return the layers as the kernels take them, seen through a map; None for a smooth solid.

        Five numbers: height of a layer; how far below its middle its outline is taken; number of layers; what
        is added to a height to count it from the foot; least slope. InputError for a solid that leans.
        """
        if not self.layer_m:
            return None
        if tuple(affine[2, :3]) != (0.0, 0.0, 1.0):
            raise InputError(
                "a solid with printed layers or its sensor is tilted; expected both upright",
                next="layer_m=0",
            )
        foot_m = self.foot_m
        slack_m = _SLACK * self.layer_m
        top_m = float(self.vertices_m[:, 2].max())
        count = np.floor((top_m - foot_m + slack_m) / self.layer_m - 0.5) + 1
        return np.array([self.layer_m, slack_m, count, -affine[2, 3] - foot_m, _LEVEL])


def _face_blocks(vertices: Float64, faces: Int32) -> tuple[Int32, Float64]:
    """Sort faces so that neighbours lie together; return them and a ball around each run of about 32.

    Most of a solid is outside the window of a touch, so that one test leaves out a run.
    """
    # Corner by corner throughout: numpy reduces over an axis of three many times slower.
    first, second, third = (vertices[faces[:, k]] for k in range(3))
    middles = (first[:, :2] + second[:, :2] + third[:, :2]) / 3
    cells = np.floor((middles - vertices[:, :2].min(axis=0)) / _CELL_OF_FACES_M).astype(np.int64)
    along = second - first
    across = third - first
    # Faces that look down are never touched. Without them, the balls around the others are smaller.
    down = along[:, 0] * across[:, 1] - along[:, 1] * across[:, 0] <= 0
    order = np.lexsort((cells[:, 0], cells[:, 1], down))
    corners = [corner[order] for corner in (first, second, third)]
    # Runs of one length, the last one shorter: their number tells the kernel where each begins.
    count = -(-len(faces) // _FACES_PER_BLOCK)
    per_block = -(-len(faces) // count)
    starts = np.arange(0, len(faces), per_block)
    low, high = (
        extreme.reduceat(extreme(extreme(corners[0], corners[1]), corners[2]), starts)
        for extreme in (np.minimum, np.maximum)
    )
    centre = (low + high) / 2
    around = np.repeat(centre, per_block, axis=0)[: len(faces)]
    x, y, z = ((corner - around).T for corner in corners)
    far = np.maximum(np.maximum((x * x).sum(axis=0), (y * y).sum(axis=0)), (z * z).sum(axis=0))
    blocks = np.column_stack([centre, np.sqrt(np.maximum.reduceat(far, starts))])
    return np.ascontiguousarray(faces[order]), blocks


def _digest(values: AnyArray) -> tuple[str, bytes]:
    """Return type, shape and checksum of an array."""
    content = np.ascontiguousarray(values)
    return f"{content.dtype}{content.shape}", xxhash.xxh3_128_digest(content.tobytes())


# By content, which takes a thousandth of the time of the check: a mesh may change in place.
_SOLIDS: cache.MemoryCache[tuple[object, ...], Pressable] = cache.MemoryCache(
    _CACHE_BYTES, lambda solid: solid.vertices_m.nbytes + solid.faces.nbytes + solid.blocks_m.nbytes
)


def _require_closed(mesh: Mesh) -> None:
    verdict = check_manifold(mesh)
    if verdict.problem == "not-manifold":
        # Published digits repeat corners; what counts is whether the surface is closed in space.
        merged = mesh.merged()
        verdict = check_manifold(merged)
    if verdict.problem not in _HARMLESS:
        repair = "repair it, `mnist3d validate FILE` names the problem"
        if verdict.problem == "no-volume":
            repair = "check its unit: metres in Python, millimetres in files but GLB; or repair it"
        raise InputError(
            f"the mesh bounds no solid ({verdict.problem}: {verdict.detail}); expected a closed mesh",
            next=repair,
        )
