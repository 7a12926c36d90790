"""Where objects stand, when two stand far enough apart, and the meshes of many scenes at once."""

from __future__ import annotations

import warnings
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import accumulate
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from starstruck_gen.shapes import STAR
from starstruck_gen.solid import Prisms, prism_solid, prisms
from tactile_toolkit.arithmetic import cosine_sine
from tactile_toolkit.mesh.mesh import MM_PER_M, Mesh
from tactile_toolkit.read.columns import RaggedColumn

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


@dataclass(frozen=True, slots=True)
class Rejected:
    """A position that was drawn and not taken.

    ``blocker`` is the object, the first found, that ``candidate`` would have come too close to; in a layout
    that was given up it is not part of the scene.
    """

    candidate: Placement
    blocker: Placement
    given_up: bool


Clear = Callable[[Placement, Placement, float], bool]
"""Whether two objects keep a clearance in metres."""


def circles_clear(one: Placement, other: Placement, clearance_m: float) -> bool:
    """Return whether circumscribed circles keep a clearance: the rule of package tactile-mnist 0.13.0."""
    least_m = one.radius_m + other.radius_m + clearance_m + STORAGE_MARGIN_M
    # Squares, no root: this is asked up to 100 times for each pair of objects.
    return (one.x_m - other.x_m) ** 2 + (one.y_m - other.y_m) ** 2 > least_m * least_m


def outlines_clear(one: Placement, other: Placement, clearance_m: float) -> bool:
    """Return whether the outlines themselves keep a clearance; measured by manifold3d.

    An object inside another's hole is clear of it, one inside its solid is not.
    """
    if circles_clear(one, other, clearance_m):
        return True
    first, second = _standing(one), _standing(other)
    least_mm = (clearance_m + STORAGE_MARGIN_M) * MM_PER_M
    # The gap alone would not reveal an object inside another one, whose surfaces can be far apart; and of two
    # that overlap it takes several times as long to find.
    return bool((first ^ second).is_empty() and first.min_gap(second, 2 * least_mm) > least_mm)


COLLISION_TESTS: dict[str, Clear] = {"circles": circles_clear, "exact": outlines_clear}
"""Collision rules by their name in the specification."""


def _standing(placement: Placement) -> Any:
    """Return the solid of an object where it stands, millimetres, 1 mm high."""
    c, s = cosine_sine(placement.angle_rad)
    x_mm, y_mm = placement.x_m * MM_PER_M, placement.y_m * MM_PER_M
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

    vertices_m: RaggedColumn
    faces: RaggedColumn

    def __len__(self) -> int:
        return len(self.vertices_m)

    def __getitem__(self, index: int) -> Mesh:
        """Return the mesh of one scene: views, no copies."""
        return Mesh(self.vertices_m[index], self.faces[index])


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
    outlines = [prisms(tuple([placement.shape for placement in layout])) for layout in layouts]
    vertices = _vertices(layouts, outlines)
    faces = _concat([made.faces for made in outlines], 3, np.int32)
    return SceneMeshes(
        RaggedColumn(vertices, _offsets([2 * len(made.corners) for made in outlines])),
        RaggedColumn(faces, _offsets([len(made.faces) for made in outlines])),
    )


def stamp(layouts: Sequence[Sequence[Placement]]) -> SceneMeshes:
    """Make the meshes of a batch of scenes.

    .. deprecated:: 0.1
       Use :func:`build_meshes`.
    """
    message = "starstruck_gen.stamp is deprecated; use starstruck_gen.build_meshes"
    warnings.warn(message, DeprecationWarning, stacklevel=2)
    return build_meshes(layouts)


def _vertices(layouts: Sequence[Sequence[Placement]], outlines: Sequence[Prisms]) -> NDArray[np.float32]:
    """Turn, scale and move the corners of all objects, each standing twice: on the plate and above it."""
    poses = [
        (x, y, cosine * radius, sine * radius, height)
        for layout in layouts
        for _, x, y, angle, radius, height in layout
        for cosine, sine in (cosine_sine(angle),)
    ]
    counts = _concat([made.corner_counts for made in outlines], None, np.int64)
    x, y, c, s, height = np.array(poses, dtype=np.float64).reshape(-1, 5).T.repeat(counts, axis=1)
    corners = _concat([made.corners for made in outlines], 2, np.float64)
    # In double precision up to here and rounded once, so that a scene's bytes do not depend on its batch.
    vertices = np.zeros((len(corners), 2, 3), dtype=np.float32)
    vertices[:, :, 0] = (c * corners[:, 0] - s * corners[:, 1] + x)[:, None]
    vertices[:, :, 1] = (s * corners[:, 0] + c * corners[:, 1] + y)[:, None]
    vertices[:, 1, 2] = height
    return vertices.reshape(-1, 3)


def _concat(parts: list[NDArray[Any]], width: int | None, dtype: type[np.generic]) -> NDArray[Any]:
    return np.concatenate(parts) if parts else np.zeros((0, width) if width else 0, dtype)


def _offsets(counts: list[int]) -> NDArray[np.int64]:
    return np.array([0, *accumulate(counts)], dtype=np.int64)
