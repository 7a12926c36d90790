"""The search for the thinnest wall agrees with a search over all pairs of triangles in plain NumPy."""

from __future__ import annotations

import math
from typing import Any

import manifold3d
import numpy as np
import pytest
from hypothesis import given, settings, strategies as st

from tactile_toolkit.mesh import box_tree
from tactile_toolkit.mesh.walls import FACING, thinnest_wall_mm
from tests.tactile_toolkit.mesh.solid_files import surface_of, turned

REACH_MM = 2.5
# Limits of the definition: along the surface, along an edge, in a plane, on round surfaces.
ALONG, LENGTHWISE, LEVEL = 0.05, math.sqrt(1 - FACING**2), 1e-9
ROUND_CORNER = math.cos(math.radians(20))


@given(st.integers(0, 2**32 - 1), st.integers(0, 70), st.floats(0.0, 4.0))
def test_boxes_that_meet_are_found_once(seed: int, count: int, reach_mm: float) -> None:
    random = np.random.default_rng(seed)
    corners_mm = random.uniform(0, 20, (count, 1, 3)) + random.uniform(0, 4, (count, 3, 3))
    low, high = corners_mm.min(axis=1) - reach_mm / 2, corners_mm.max(axis=1) + reach_mm / 2
    meet = ((low[:, None] <= high) & (low <= high[:, None])).all(axis=2)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(box_tree, "PAIRS_AT_ONCE", 16)
        parts = [part.T.tolist() for part in box_tree.near_pairs(corners_mm, reach_mm)]
    assert all(len(part) <= 16 for part in parts)
    pairs = [tuple(sorted(pair)) for part in parts for pair in part]
    assert sorted(pairs) == [
        (first, second) for first, second in np.argwhere(meet).tolist() if first < second
    ]


def dot(u: np.ndarray, v: np.ndarray) -> np.ndarray:
    return np.einsum("...i,...i->...", u, v)  # numpy sums short rows slowly


def unit(u: np.ndarray) -> np.ndarray:
    return u / np.maximum(np.linalg.norm(u, axis=-1, keepdims=True), 1e-300)


def wall_of_all_pairs(vertices: np.ndarray, faces: np.ndarray) -> float:
    """Return the thinnest wall below the reach, from all pairs of triangles."""
    corners = vertices[faces]
    doubled = np.cross(corners[:, 2] - corners[:, 0], corners[:, 1] - corners[:, 0])
    inward = unit(doubled)
    at_corner = np.zeros_like(vertices)
    np.add.at(at_corner, faces.ravel(), np.repeat(doubled, 3, axis=0))
    at_corner = unit(at_corner)
    half_edge = {
        (a, b): face for face, (p, q, r) in enumerate(faces.tolist()) for a, b in ((p, q), (q, r), (r, p))
    }
    joined = (faces[:, None, :, None] == faces[None, :, None, :]).any(axis=(2, 3))
    first, second = np.nonzero(~joined | (inward @ inward.T <= 1 - 2 * FACING**2))
    # A part of each triangle lies in front of the other.
    depths = np.einsum("nkc,nc->nk", corners[second] - corners[first, :1], inward[first]).max(axis=1)
    before = np.zeros((len(faces), len(faces)), dtype=bool)
    before[first, second] = depths > LEVEL
    first, second = np.nonzero(before & before.T)
    if joined[first, second].any():
        return 0.0
    best = math.inf
    for k in range(3):
        # From a corner of one triangle straight to the inside of the other.
        point, into = corners[first, k], inward[second]
        depth = dot(point - corners[second, 0], into)
        normal = at_corner[faces[first, k]]
        is_round = dot(normal, inward[first]) >= ROUND_CORNER
        cosine = np.where(is_round, -dot(normal, into), -dot(inward[first], into))
        faced = (depth > 0) & (cosine >= FACING)
        for start in range(3):
            along = corners[second, (start + 1) % 3] - corners[second, start]
            faced &= dot(np.cross(along, into), point - corners[second, start]) >= -1e-9 * dot(along, along)
        best = min(best, (2 * depth[faced] / (1 + cosine[faced])).min(initial=math.inf))
        for m in range(3):
            wall = wall_between_edges(vertices, faces, inward, half_edge, (first, k), (second, m))
            best = min(best, wall)
    return best


def wall_between_edges(
    vertices: np.ndarray,
    faces: np.ndarray,
    inward: np.ndarray,
    half_edge: dict[Any, int],
    first: Any,
    second: Any,
) -> float:
    ends = [(faces[face, k], faces[face, (k + 1) % 3]) for face, k in (first, second)]
    p, q = (vertices[start] for start, _ in ends)
    u, v = (vertices[end] - vertices[start] for start, end in ends)
    uu, vv, uv, ur, vr = dot(u, u), dot(v, v), dot(u, v), dot(u, p - q), dot(v, p - q)
    slant = uu * vv - uv * uv
    skew = slant > 1e-12 * uu * vv
    s = np.where(skew, np.clip((uv * vr - ur * vv) / np.where(skew, slant, 1), 0, 1), 0.5)
    t = np.clip((uv * s + vr) / vv, 0, 1)
    s = np.clip((uv * t - ur) / uu, 0, 1)
    offset = q + t[:, None] * v - p - s[:, None] * u
    distance = np.linalg.norm(offset, axis=1)
    near = (distance > 0) & (distance < REACH_MM)
    direction = offset[near] / distance[near, None]
    cosine = np.ones(near.sum())
    for (start, end), (face, _), way in zip(ends, (first, second), (direction, -direction), strict=True):
        start, end, own = start[near], end[near], inward[face[near]]
        beyond = inward[[half_edge[pair] for pair in zip(end.tolist(), start.tolist(), strict=True)]]
        along = unit(vertices[end] - vertices[start])
        # Away from the edge on either side, and into the solid.
        leads = np.maximum(dot(np.cross(along, own), way), -dot(np.cross(along, beyond), way))
        sinks = dot(own, way), dot(beyond, way)
        notch = (leads <= ALONG) & (np.minimum(*sinks) > LEVEL) & (dot(along, way) ** 2 <= LENGTHWISE**2)
        hollow = dot(own, np.cross(beyond, along)) < -LEVEL
        straight = np.where(hollow, 1.0, np.sqrt(1 - np.minimum(dot(along, way) ** 2, 1)))
        cosine = np.minimum(cosine, np.where(notch, straight, np.maximum(*sinks)))
    faced = cosine >= FACING
    return float((distance[near][faced] / cosine[faced]).min(initial=math.inf))


def require_same(vertices: np.ndarray, faces: np.ndarray) -> float:
    expected = wall_of_all_pairs(vertices, faces)
    wall_mm = thinnest_wall_mm(vertices, faces, REACH_MM)
    assert wall_mm == pytest.approx(expected if expected < REACH_MM else math.inf, abs=2e-6)
    return wall_mm


def block() -> Any:
    return manifold3d.Manifold.cube((8, 6, 8), True)


def sheared_box(rng: np.random.Generator) -> Any:
    shear = np.eye(3, 4) + np.triu(rng.uniform(-0.8, 0.8, (3, 4)), 1)
    return manifold3d.Manifold.cube(rng.uniform(0.3, 4, 3).tolist(), True).transform(shear)


def wedge(rng: np.random.Generator) -> Any:
    """Return a wedge of about 18 degrees, the limit of a wall at a corner, or 36 degrees, that at an edge."""
    rise = 8 * math.tan(math.radians(rng.choice([10, 17.5, 18.1, 18.3, 30, 36, 36.5])))
    thick, skew = rng.uniform(0.2, 2), rng.uniform(-1, 1)
    outline = [(0, 0), (8, 0), (8, thick + rise), (skew, thick)]
    return manifold3d.CrossSection([outline]).extrude(rng.uniform(1, 5)).refine_to_length(rng.uniform(1.5, 3))


def two_blocks_joined(rng: np.random.Generator) -> Any:
    """Return a solid with a slanted neck between two notches."""
    x, z = rng.uniform(-0.6, 0.6), rng.uniform(0.3, 2)
    a, b, c, d = rng.uniform(-2, 2, 4)
    outline = [(-6, 6), (-6, a), (0, 0), (b, -6), (6, -6), (6, z + c), (x, z), (x + d, 6)]
    return manifold3d.CrossSection([outline]).extrude(rng.uniform(1, 4)).refine(int(rng.integers(1, 3)))


def cut_from_both_sides(rng: np.random.Generator) -> Any:
    """Two notches, sharp or blunt, that neither lie above each other nor lead the same way."""
    solid, gap = block(), rng.uniform(0.3, 2.3)
    for side in (0, 180):
        wide, lean = 8 * math.tan(math.radians(rng.uniform(5, 85))), 8 * rng.uniform(-1, 1)
        blade = manifold3d.CrossSection([[(0, 0), (wide + lean, 8), (lean - wide, 8)]]).extrude(
            20, rng.integers(6)
        )
        blade = blade.translate((rng.uniform(-0.3, 0.3) * gap, gap / 2, -10)).rotate((90 + side, 0, 0))
        solid -= blade.rotate((float(rng.uniform(-20, 20)), 0, float(rng.uniform(-30, 30))))
    return solid


def dented(rng: np.random.Generator) -> Any:
    """Corners that point into the solid from both sides."""
    solid = block()
    for side in (-1, 1):
        spike = manifold3d.Manifold.tetrahedron().scale(rng.uniform(1, 4, 3).tolist())
        position = (*rng.uniform(-1, 1, 2), side * rng.uniform(1, 4))
        solid -= spike.rotate(rng.uniform(0, 360, 3).tolist()).translate(position)
    return solid


def flat_ball(rng: np.random.Generator) -> Any:
    return manifold3d.Manifold.sphere(3, int(rng.integers(6, 12))).scale(rng.uniform(0.1, 1, 3).tolist())


def two_hulls(rng: np.random.Generator) -> Any:
    first, second = (manifold3d.Manifold.hull_points(rng.uniform(-2, 2, (7, 3))) for _ in range(2))
    return first + second


SOLIDS = [sheared_box, wedge, two_blocks_joined, cut_from_both_sides, dented, flat_ball, two_hulls]


@pytest.mark.one_at_a_desk
@pytest.mark.parametrize("make", SOLIDS)
@settings(max_examples=settings.default.max_examples // 3)
@given(seed=st.integers(0, 2**32 - 1))
def test_no_wall_is_left_out(make: Any, seed: int) -> None:
    vertices, faces = surface_of(make(np.random.default_rng(seed)))
    require_same(turned(vertices, seed), faces)


@pytest.mark.one_at_a_desk
@pytest.mark.parametrize("taper_deg", [18, 15])
@pytest.mark.parametrize("side", [-1, 1])
@pytest.mark.parametrize("axes", [(0, 1, 2), (1, 2, 0), (2, 0, 1)])
def test_oblique_distances_out_of_both_boxes_are_found(taper_deg: float, side: int, axes: Any) -> None:
    """Test the thin end of a wedge of small triangles, turned so that its top lies along the axes.

    Every shortest distance leads straight down from the end of the top, past the boxes of those triangles.
    """
    thick, rise = 1.5, 1.6 * math.tan(math.radians(taper_deg))
    outline = [(0, 0), (1.6, 0), (1.6, thick + rise), (0, thick)]
    solid = manifold3d.CrossSection([outline]).extrude(1.6).refine_to_length(0.42).rotate((0, 0, -taper_deg))
    vertices, faces = surface_of(solid)
    wall = require_same((side * vertices)[:, axes], faces[:, ::side])
    assert thick <= wall <= thick / FACING
