"""Shapes as solids, proved once; when two stand far enough apart; and the meshes of many scenes at once."""

from __future__ import annotations

import math
import re
from collections.abc import Sequence
from dataclasses import dataclass, fields, is_dataclass
from functools import lru_cache
from itertools import accumulate, pairwise
from typing import Any, NamedTuple, TypeVar

import numpy as np

from starstruck_gen.shapes import (
    KINDS,
    PUBLISHED_RADIUS_M,
    STAR,
    Outline,
    Proportions,
    Shape,
    add_kind,
    outline,
    read_only,
)
from tactile_toolkit import mesh, read
from tactile_toolkit.arithmetic import cosine_sine
from tactile_toolkit.array_types import Float64, Int32, Int64
from tactile_toolkit.errors import InputError

K = TypeVar("K", bound=type[Proportions])

_MOST_KEPT = 1_024
_TOOLKIT = frozenset(KINDS)
_REACH_TOLERANCE = 1e-9


@dataclass(frozen=True, slots=True, eq=False)
class Prism:
    """The solid of a shape, up to its size; lengths in units of the circumscribed radius.

    Vertex 2i of the solid is corner i on the plate, vertex 2i + 1 the one above it. Arrays are read-only.
    """

    corners: Float64  # (n, 2): all rings of the outline one after another
    cap: Int32  # (T, 3): triangles over all corners, counter-clockwise, none on another's edge
    faces: Int32  # (F, 3): triangles of the solid, outward
    area: float  # of the outline
    thinnest: float  # least height of a triangle of the cap: moves below half of it turn no triangle over

    @property
    def vertex_count(self) -> int:
        """Vertices of the solid."""
        return 2 * len(self.corners)

    def vertices(self, height: float) -> Float64:
        """Return the vertices of an unturned prism of radius 1, shape (V, 3)."""
        standing = np.zeros((self.vertex_count, 3))
        standing[:, :2] = np.repeat(self.corners, 2, axis=0)
        standing[1::2, 2] = height
        return standing


@lru_cache(_MOST_KEPT)
def prism(key: str) -> Prism:
    """Return the solid of the shape that a key names, made and proved on first use.

    Raises InputError for an unknown shape, and as :func:`proved_prism`.
    """
    return proved_prism(key, outline(key))


def proved_prism(key: str, rings: Outline) -> Prism:
    """Make the solid of an outline and prove it.

    Raises InputError for one that bounds no area (turned the wrong way, or crossing itself).
    """
    import manifold3d

    corners = np.concatenate(rings)
    # Triangulated once for a shape: 3,300 scenes hold some 15,000 objects of three shapes.
    cap = np.asarray(manifold3d.triangulate(list(rings)), dtype=np.int32)
    a, b, c = (corners[cap[:, index]] for index in range(3))
    doubled_areas = (b - a)[:, 0] * (c - a)[:, 1] - (b - a)[:, 1] * (c - a)[:, 0]
    # A triangle's least height is twice its area over its longest side.
    sides = np.linalg.norm(corners[cap] - corners[np.roll(cap, 1, axis=1)], axis=2)
    made = Prism(
        corners,
        cap,
        _faces([len(ring) for ring in rings], cap),
        area=float(doubled_areas.sum() / 2),
        thinnest=float((doubled_areas / sides.max(axis=1)).min()),
    )
    for array in (made.corners, made.cap, made.faces):
        array.setflags(write=False)
    verdict = mesh.check_manifold(mesh.Mesh(made.vertices(0.5) * PUBLISHED_RADIUS_M, made.faces))
    wrong = verdict.problem or ("in pieces" if verdict.bodies != 1 else None)
    # A figure of eight can pass for a solid: only its cap shows triangles that are turned over.
    if wrong is None and (doubled_areas <= 0).any():
        wrong = "crossing itself"
    if wrong is not None:
        raise InputError(
            f"the outline of shape {key!r} bounds no area ({wrong}); expected one outer ring "
            "counter-clockwise, then holes clockwise, none touching another"
        )
    return made


@dataclass(frozen=True, slots=True, eq=False)
class Prisms:
    """The solids of several shapes one after another: a scene before anything is placed; all read-only."""

    corners: Float64  # (n, 2), as of the prisms
    corner_counts: Int64  # of each prism
    faces: Int32  # (F, 3), numbered through all prisms


@lru_cache(_MOST_KEPT)
def prisms(keys: tuple[str, ...]) -> Prisms:
    """Return the solids of the shapes that some keys name, in their order.

    Kept, as scenes hold the same few shapes in the same few orders: of the published ones there are 189.
    """
    each = [prism(key) for key in keys]
    # Empty arrays first, since a layout may be empty.
    corners, faces, vertices = [np.zeros((0, 2))], [np.zeros((0, 3), np.int32)], 0
    for one in each:
        corners.append(one.corners)
        faces.append(one.faces + np.int32(vertices))
        vertices += one.vertex_count
    counts = np.array([len(one.corners) for one in each], dtype=np.int64)
    made = Prisms(np.concatenate(corners), counts, np.concatenate(faces))
    for array in (made.corners, made.corner_counts, made.faces):
        array.setflags(write=False)
    return made


def _faces(ring_sizes: list[int], cap: Int32) -> Int32:
    """Join the two caps by walls that follow each ring; a hole runs clockwise, so its walls face inwards."""
    starts = np.cumsum([0, *ring_sizes])
    here = np.arange(starts[-1])
    following = np.concatenate([np.roll(here[a:b], -1) for a, b in pairwise(starts)])
    walls = [
        np.stack([2 * here, 2 * following, 2 * following + 1], axis=1),
        np.stack([2 * here, 2 * following + 1, 2 * here + 1], axis=1),
    ]
    return np.concatenate([2 * cap + 1, 2 * cap[:, ::-1], *walls]).astype(np.int32)


@lru_cache(_MOST_KEPT)
def prism_solid(key: str, radius_m: float) -> Any:
    """Return the solid of a shape for manifold3d: millimetres, 1 mm high, unturned, centre at the origin."""
    made = prism(key)
    vertices_m = made.vertices(0.0) * radius_m
    vertices_m[1::2, 2] = 1e-3
    return mesh.Mesh(vertices_m, made.faces).to_manifold()


def require_fine_steps(
    shapes: Sequence[Shape], half_area_m: tuple[float, float], cell_m: tuple[float, float]
) -> None:
    """Refuse shapes so small, in a cell so large, that float32 coordinates could turn a triangle over.

    Three corners that move by up to e each stay in their order while the triangle is thicker than 2 e.
    """
    for shape in shapes:
        thinnest_m = prism(shape.key).thinnest * shape.radius_m
        farthest_m = np.array(half_area_m) + shape.radius_m
        # Rounding moves a corner by half a step along x and half a step along y.
        moved_m = math.hypot(*np.spacing(farthest_m.astype(np.float32)).tolist()) / 2
        if thinnest_m <= 2 * moved_m:
            raise InputError(
                f"cell_m of the scene specification is {cell_m!r}; expected a smaller one with shape "
                f"{shape.key!r} of radius_m {shape.radius_m!r}: its thinnest triangle is {thinnest_m:.2g} m, "
                f"and storing coordinates as float32 moves corners by up to {moved_m:.2g} m there",
                next="lower cell_m (--cell-mm) or the corners of the shape (segments, points), or raise "
                "radius_m (--radius-mm)",
            )


def register_shape(kind: K) -> K:
    """Make a kind of shape known, so that :class:`starstruck_gen.Shape` and all that follows take it.

    Parameters
    ----------
    kind : type
        A frozen dataclass with slots, derived from :class:`starstruck_gen.Proportions`: ``name`` names the
        shape, ``rings()`` gives its outline, and each field is a number with a default. A field's range is
        its metadata ``least`` and ``most``.

    Returns
    -------
    type : the same, so that this serves as a decorator

    Raises
    ------
    InputError
        The name is taken or not a plain word, a field is not a number, or the default outline bounds no area
        or does not reach distance 1 from the origin.

    Notes
    -----
    Specifications and shapes carry the class with them when they are pickled. Reading JSON or a stored data
    set needs the kind registered first. The command line has the toolkit's own shapes alone.

    Examples
    --------
    >>> from dataclasses import dataclass, field
    >>> import numpy as np
    >>> @register_shape
    ... @dataclass(frozen=True, slots=True)
    ... class Kite(Proportions):
    ...     name = "kite"
    ...     width: float = field(default=0.6, metadata={"least": 0.1, "most": 1.0})
    ...
    ...     def rings(self):
    ...         return (np.array([(1.0, 0.0), (0.0, self.width), (-0.5, 0.0), (0.0, -self.width)]),)
    >>> from starstruck_gen import Shape
    >>> Shape("kite", 0.012, Kite(width=0.4)).key
    'kite(width=0.4)'
    """
    _require_described(kind)
    former = KINDS.get(kind.name)
    if former is kind:
        return kind
    # A cell of a notebook that is run again defines its class once more; that class replaces its former.
    if former is not None and (kind.name in _TOOLKIT or former.__qualname__ != kind.__qualname__):
        raise InputError(f"shape {kind.name!r} is taken by {former.__qualname__}; expected another name")
    made = proved_prism(kind.name, read_only(kind().rings()))
    reach = float(np.linalg.norm(made.corners, axis=1).max())
    if abs(reach - 1.0) > _REACH_TOLERANCE:
        raise InputError(
            f"the outline of shape {kind.name!r} reaches distance {reach:g} from the origin; expected 1, "
            "the circumscribed radius"
        )
    add_kind(kind)
    # What is kept by key may belong to a former kind of the same name.
    for kept in (outline, prism, prisms, prism_solid):
        kept.cache_clear()
    return kind


def _require_described(kind: Any) -> None:
    is_kind = isinstance(kind, type) and issubclass(kind, Proportions) and is_dataclass(kind)
    if not (is_kind and isinstance(kind.name, str) and re.fullmatch(r"[A-Za-z_]\w*", kind.name)):
        raise InputError(
            f"{kind!r} is not a kind of shape; expected a frozen dataclass derived from Proportions, with a "
            "plain word as its name"
        )
    for entry in fields(kind):
        if type(entry.default) not in (int, float):
            raise InputError(
                f"field {entry.name!r} of shape {kind.name!r} has the default {entry.default!r}; expected a "
                "number"
            )


STORAGE_MARGIN_M = 1e-7
"""Kept beyond the clearance asked for: storing coordinates as float32 moves them by up to a third of it."""


class Placement(NamedTuple):
    """One object of a scene.

    Frame: origin at the cell's centre, x right, y away from the robot, z up from the plate.

    Attributes
    ----------
    shape : str
        Name of the shape, with the proportions that are not its kind's own in brackets: ``star``,
        ``star(points=6)``; the ``key`` of a :class:`starstruck_gen.Shape`.
    x_m, y_m : float
        Centre of its circumscribed circle, metres.
    angle_rad : float
        Rotation about z, counter-clockwise, radians.
    radius_m : float
        Circumscribed radius, metres.
    height_m : float
        Height over the plate, metres.
    """

    shape: str
    x_m: float
    y_m: float
    angle_rad: float
    radius_m: float
    height_m: float

    @property
    def is_star(self) -> bool:
        """Whether the object counts."""
        return self.shape.partition("(")[0] == STAR


def circles_clear(one: Placement, others: Sequence[Placement], clearance_m: float) -> bool:
    """Return whether circumscribed circles keep a clearance: the rule of package tactile-mnist 0.13.0."""
    _, x_m, y_m, _, radius_m, _ = one
    # Loop and products, no call or root: this is asked up to 100 times for each pair of objects.
    for _, other_x_m, other_y_m, _, other_radius_m, _ in others:
        along_m, across_m = x_m - other_x_m, y_m - other_y_m
        least_m = radius_m + other_radius_m + clearance_m + STORAGE_MARGIN_M
        if not along_m * along_m + across_m * across_m > least_m * least_m:  # no place that is NaN is clear
            return False
    return True


def outlines_clear(one: Placement, others: Sequence[Placement], clearance_m: float) -> bool:
    """Return whether the outlines themselves keep a clearance; measured by manifold3d.

    An object inside another's hole is clear of it, one inside its solid is not.
    """
    least_mm = (clearance_m + STORAGE_MARGIN_M) * mesh.MM_PER_M
    near = (other for other in others if not circles_clear(one, [other], clearance_m))
    pairs = ((_standing(one), _standing(other)) for other in near)
    # The gap alone would not reveal an object inside another one, whose surfaces can be far apart; and of two
    # that overlap it takes several times as long to find.
    return all((a ^ b).is_empty() and a.min_gap(b, 2 * least_mm) > least_mm for a, b in pairs)


COLLISION_TESTS = {"circles": circles_clear, "exact": outlines_clear}
"""Collision rules by name: does an object keep a clearance, in metres, to some others?"""


def _standing(placement: Placement) -> Any:
    """Return the solid of an object where it stands, millimetres, 1 mm high."""
    c, s = cosine_sine(placement.angle_rad)
    x_mm, y_mm = placement.x_m * mesh.MM_PER_M, placement.y_m * mesh.MM_PER_M
    matrix = np.array([[c, -s, 0.0, x_mm], [s, c, 0.0, y_mm], [0.0, 0.0, 1.0, 0.0]])
    return prism_solid(placement.shape, placement.radius_m).transform(matrix)


@dataclass(frozen=True, slots=True, eq=False)
class SceneMeshes:
    """The meshes of a batch of scenes.

    Attributes
    ----------
    vertices_m : RaggedColumn
        Row i: vertices of scene i, shape (V_i, 3), float32, metres, as they are stored.
    faces : RaggedColumn
        Row i: triangles of scene i, shape (F_i, 3), int32, numbered within the scene.
    """

    vertices_m: read.RaggedColumn
    faces: read.RaggedColumn

    def __len__(self) -> int:
        return len(self.vertices_m)

    def __getitem__(self, index: int) -> mesh.Mesh:
        """Return the mesh of one scene: views, no copies."""
        return mesh.Mesh(self.vertices_m[index], self.faces[index])


def build_meshes(layouts: Sequence[Sequence[Placement]]) -> SceneMeshes:
    """Make the meshes of a batch of scenes.

    Each object is one solid of its own, in order of the placements, standing on z = 0; see
    :class:`starstruck_gen.Placement` for the frame. A scene's mesh does not depend on what else is
    in the batch.

    Parameters
    ----------
    layouts : sequence of sequence of Placement
        Objects of each scene.

    Returns
    -------
    SceneMeshes
    """
    from starstruck_gen.kernels import standing_vertices

    outlines = [prisms(tuple([placement.shape for placement in layout])) for layout in layouts]
    poses = np.array([placement[1:] for layout in layouts for placement in layout], np.float64)
    parts = outlines or [prisms(())]  # there may be no layout
    corners = np.concatenate([made.corners for made in parts])
    corner_counts = np.concatenate([made.corner_counts for made in parts])
    faces = np.concatenate([made.faces for made in parts])
    vertices = standing_vertices(poses.reshape(-1, 5), corners, corner_counts)
    return SceneMeshes(
        read.RaggedColumn(vertices, _offsets([2 * len(made.corners) for made in outlines])),
        read.RaggedColumn(faces, _offsets([len(made.faces) for made in outlines])),
    )


def _offsets(counts: list[int]) -> Int64:
    return np.array([0, *accumulate(counts)], dtype=np.int64)
