"""Whether the surface of a body crosses itself: edges against triangles, over a tree of boxes.

Where two sheets of a closed surface cross there is space that is enclosed twice, or inside out, and the
volume counts it so. Sheets that only touch enclose nothing twice and are left alone.

Sheets cross where an edge passes through a triangle with which it shares no corner, and neighbours where one
is folded back onto the other. An edge that meets a triangle only within :func:`tolerance_mm` of its ends, or
of the rim of the triangle, may touch it or be the seam of a crossing: winding numbers of points around tell.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from tactile_toolkit.mesh.raster import positions_in_runs

__all__ = ["faces_not_proven_free", "self_crossing", "tolerance_mm"]

Numbers = NDArray[np.float64]
Indices = NDArray[np.int64]

_TOLERANCE = 2.0**-21
# Each of them takes a pass over all faces.
_MOST_ODD = 64
# Each takes 26 winding numbers, every one over all faces.
_DOUBTS_ASKED = 32
# How many tolerances from a doubtful place the winding number is asked for.
_ASIDE = 16.0


def tolerance_mm(vertices_mm: Numbers) -> float:
    """Return how deep sheets may lie in one another: a few times what single precision moves them."""
    return _TOLERANCE * float(np.abs(vertices_mm).max())


def self_crossing(vertices_mm: Numbers, faces: Indices, bodies: int = 1) -> Numbers | None:
    """Return a place, shape (3,), where a body of a closed manifold mesh crosses itself; None if none does.

    ``bodies`` are the connected surfaces of the mesh; crossings of different ones are not looked for.
    """
    suspects = faces_not_proven_free(vertices_mm, faces)
    if not len(suspects):
        return None
    if bodies == 1:
        return _crossing_among(vertices_mm, faces, suspects)
    body = _body_of(faces, len(vertices_mm))
    for one in np.unique(body[suspects]):
        own = np.flatnonzero(body == one)
        place = _crossing_among(vertices_mm, faces[own], np.flatnonzero(np.isin(own, suspects)))
        if place is not None:
            return place
    return None


def _body_of(faces: Indices, vertices: int) -> Indices:
    from scipy import sparse
    from scipy.sparse import csgraph

    ends, others = faces[:, [0, 1]].ravel(), faces[:, [1, 2]].ravel()
    links = sparse.coo_matrix((np.ones(len(ends), np.int8), (ends, others)), shape=(vertices, vertices))
    return np.asarray(csgraph.connected_components(links, directed=False)[1][faces[:, 0]])


# --- proof for what is made of two reliefs back to back -------------------------------------------


def faces_not_proven_free(vertices_mm: Numbers, faces: Indices) -> Indices:
    """Return the faces that may cross others; fewer than all where the surface splits along a level plane.

    Over any point of the plane the upper half has as many more faces that look up than faces that do not as
    its rim winds around the point. If the rim is simple that is at most one: then no two faces share a point
    unless one lies there that does not look up, and of these there are few.
    """
    everything = np.arange(len(faces))
    x, y, z = np.ascontiguousarray(vertices_mm.T)
    level = (z.max() + z.min()) / 2
    corners = np.ascontiguousarray(faces.T)
    # Of a corner: above, in or below the level; a half has corners of one kind beside those in the level.
    side = np.sign(z - level).astype(np.int8)[corners]
    least, most = np.minimum.reduce(side), np.maximum.reduce(side)
    # A face passes through the level, none reaches it, or one lies in it: there are no two halves.
    if (least * most < 0).any() or (least == most).all() or ((least == 0) & (most == 0)).any():
        return everything
    above = most > 0
    (ax, bx, cx), (ay, by, cy) = x[corners], y[corners]
    facing = (bx - ax) * (cy - ay) - (by - ay) * (cx - ax)
    odd = np.flatnonzero(np.where(above, facing, -facing) <= 0)
    if len(odd) > _MOST_ODD or not _rim_is_simple(x, y, corners[:, above], side[:, above] == 0):
        return everything
    if not len(odd):
        return odd
    low_x, high_x = np.minimum(np.minimum(ax, bx), cx), np.maximum(np.maximum(ax, bx), cx)
    low_y, high_y = np.minimum(np.minimum(ay, by), cy), np.maximum(np.maximum(ay, by), cy)
    near = np.zeros(len(faces), dtype=bool)
    for face in odd:
        beside = np.flatnonzero((low_x <= high_x[face]) & (high_x >= low_x[face]))
        near[beside] |= (low_y[beside] <= high_y[face]) & (high_y[beside] >= low_y[face])
    return np.flatnonzero(near)


def _rim_is_simple(x: Numbers, y: Numbers, upper: Indices, on_level: NDArray[np.bool_]) -> bool:
    """Tell whether the rim of the upper half is closed lines apart from each other that wind once at most."""
    after = (1, 2, 0)
    touching = [np.flatnonzero(on_level[corner] & on_level[after[corner]]) for corner in range(3)]
    start = np.concatenate([upper[corner, found] for corner, found in enumerate(touching)])
    end = np.concatenate([upper[after[corner], found] for corner, found in enumerate(touching)])
    # An edge that the half has in both directions is not of its rim.
    rim = ~np.isin(start * len(x) + end, end * len(x) + start)
    start, end = start[rim], end[rim]
    following = dict(zip(start.tolist(), end.tolist(), strict=True))
    if len(following) != len(start):
        return False  # lines that share a corner
    # A sweep along x: only edges whose ranges overlap there are compared.
    order = np.argsort(np.minimum(x[start], x[end]), kind="stable")
    start, end = start[order], end[order]
    px, py, qx, qy = x[start], y[start], x[end], y[end]
    low_x, high_x, low_y, high_y = (
        np.minimum(px, qx),
        np.maximum(px, qx),
        np.minimum(py, qy),
        np.maximum(py, qy),
    )
    count = np.searchsorted(low_x, high_x, side="right") - np.arange(len(start)) - 1
    one = np.repeat(np.arange(len(start)), count)
    other = one + 1 + positions_in_runs(count)
    meet = (low_y[one] <= high_y[other]) & (low_y[other] <= high_y[one])
    one, other = one[meet], other[meet]
    ax, ay, bx, by = px[one], py[one], qx[one], qy[one]
    cx, cy, dx, dy = px[other], py[other], qx[other], qy[other]
    turn_c, turn_d = (
        (bx - ax) * (y_mm - ay) - (by - ay) * (x_mm - ax) for x_mm, y_mm in ((cx, cy), (dx, dy))
    )
    turn_a, turn_b = (
        (dx - cx) * (y_mm - cy) - (dy - cy) * (x_mm - cx) for x_mm, y_mm in ((ax, ay), (bx, by))
    )
    # Edges cross unless one of them has both ends of the other on one side.
    apart = (turn_c * turn_d > 0) | (turn_a * turn_b > 0)
    # Neighbours share their corner; they are apart otherwise unless one runs back along the other.
    joined = (start[one] == end[other]) | (end[one] == start[other])
    onwards = (bx - ax) * (dx - cx) + (by - ay) * (dy - cy) > 0
    fine = np.where(joined, (turn_c != 0) | (turn_d != 0) | onwards, apart)
    return bool(fine.all()) and _winds_once(following, x, y)


def _winds_once(following: dict[int, int], x: Numbers, y: Numbers) -> bool:
    """Tell whether simple closed lines wind no more than once around any point, and never backwards."""
    lines = []
    while following:
        first, corner = following.popitem()
        line = [first, corner]
        while corner != first:
            corner = following.pop(corner)
            line.append(corner)
        lines.append((x[line], y[line]))
    for line_x, line_y in lines:
        area = (line_x[:-1] * line_y[1:] - line_x[1:] * line_y[:-1]).sum()
        winding = 0
        for other_x, other_y in lines:
            if other_x is line_x:
                continue
            ax, ay, bx, by = other_x[:-1], other_y[:-1], other_x[1:], other_y[1:]
            left = (bx - ax) * (line_y[0] - ay) - (by - ay) * (line_x[0] - ax)
            winding += int(((ay <= line_y[0]) & (by > line_y[0]) & (left > 0)).sum())
            winding -= int(((ay > line_y[0]) & (by <= line_y[0]) & (left < 0)).sum())
        if winding != (0 if area > 0 else 1):
            return False
    return True


# --- everything else ------------------------------------------------------------------------------


def _crossing_among(vertices_mm: Numbers, faces: Indices, suspects: Indices) -> Numbers | None:
    """Return where faces among the suspects cross each other, if they do."""
    from tactile_toolkit.mesh.nearness import near_pairs

    tolerance = tolerance_mm(vertices_mm)
    a, b, c = (vertices_mm[faces[suspects, corner]] for corner in range(3))
    normal = np.cross(b - a, c - a)
    doubled = np.sqrt((normal * normal).sum(axis=1))
    longest = np.sqrt(np.max([((v - u) ** 2).sum(axis=1) for u, v in ((a, b), (b, c), (c, a))], axis=0))
    # Nothing passes through what is no wider than the tolerance; its edges are those of its neighbours, too.
    wide = doubled > tolerance * longest
    suspects, normal = suspects[wide], normal[wide] / doubled[wide, None]
    triangles = faces[suspects]
    doubtful: list[Numbers] = []
    for one, other in near_pairs(vertices_mm[triangles], tolerance):
        folded = _folds(vertices_mm, triangles, normal, one, other, tolerance)
        if len(folded):
            return np.asarray(folded[0])
        for first, second in ((one, other), (other, one)):
            certain, doubts = _passages(vertices_mm, triangles, normal, first, second, tolerance)
            if len(certain):
                return np.asarray(certain[0])
            doubtful.append(doubts)
    places = np.concatenate(doubtful) if doubtful else np.zeros((0, 3))
    if not len(places):
        return None
    asked = places[np.linspace(0, len(places) - 1, min(len(places), _DOUBTS_ASKED)).astype(np.int64)]
    for place in asked:
        around = place + _ASIDE * tolerance * _DIRECTIONS
        winding = _winding_numbers(vertices_mm, faces, around)
        # Off the surface these are whole: 1 inside, 0 outside, and the quarter is for rounding.
        if ((winding > 1.25) | (winding < -0.25)).any():
            return np.asarray(place)
    return None


def _folds(
    vertices_mm: Numbers, triangles: Indices, normal: Numbers, one: Indices, other: Indices, tolerance: float
) -> Numbers:
    """Return the middle of edges at which two triangles lie on one another instead of side by side."""
    # Within 8 degrees of opposite: the angle alone does not tell a fold from a thin edge, the gap below does.
    opposed = np.flatnonzero((normal[one] * normal[other]).sum(axis=1) < -0.99)
    one, other = triangles[one[opposed]], triangles[other[opposed]]
    shared = (one[:, :, None] == other[:, None, :]).any(axis=2)
    two = shared.sum(axis=1) == 2
    one, other, shared = one[two], other[two], shared[two]
    apex = one[~shared]
    p, q = vertices_mm[one[shared].reshape(-1, 2)].transpose(1, 0, 2)
    far = other[~(other[:, :, None] == one[:, None, :]).any(axis=2)]
    along = (q - p) / np.sqrt(((q - p) ** 2).sum(axis=1, keepdims=True))
    first, second = (
        v - p - ((v - p) * along).sum(axis=1, keepdims=True) * along for v in vertices_mm[[apex, far]]
    )
    size, size_far = (np.sqrt((v * v).sum(axis=1)) for v in (first, second))
    # How far the shorter one stands off the longer.
    gap = np.minimum(size, size_far) * np.sqrt(
        ((first / size[:, None] - second / size_far[:, None]) ** 2).sum(axis=1)
    )
    return np.asarray(((p + q) / 2)[gap <= tolerance])


def _passages(
    vertices_mm: Numbers,
    triangles: Indices,
    normal: Numbers,
    target: Indices,
    passing: Indices,
    tolerance: float,
) -> tuple[Numbers, Numbers]:
    """Return where edges of triangles certainly pass through target triangles, and where they may."""
    (x, y, z), corners = np.ascontiguousarray(vertices_mm.T), triangles.T
    normal_x, normal_y, normal_z = normal.T
    level = (vertices_mm[corners[0]] * normal).sum(axis=1)[target]
    upright_x, upright_y, upright_z = normal_x[target], normal_y[target], normal_z[target]
    passers = corners[:, passing]
    depth = [upright_x * x[c] + upright_y * y[c] + upright_z * z[c] - level for c in passers]
    met = np.flatnonzero((np.minimum.reduce(depth) <= tolerance) & (np.maximum.reduce(depth) >= -tolerance))
    target, passers, depths = target[met], passers[:, met], [each[met] for each in depth]
    own = corners[:, target]
    shared = [(c == own[0]) | (c == own[1]) | (c == own[2]) for c in passers]
    ends, pairs, at = [], [], []
    for corner, after in ((0, 1), (1, 2), (2, 0)):
        start, end = depths[corner], depths[after]
        pair = np.flatnonzero(
            ~(shared[corner] | shared[after])
            & (np.minimum(start, end) <= tolerance)
            & (np.maximum(start, end) >= -tolerance)
        )
        ends.append(passers[[corner, after]][:, pair])
        at.append(np.stack([start[pair], end[pair]]))
        pairs.append(target[pair])
    (p, q), (at_p, at_q) = vertices_mm[np.concatenate(ends, axis=1)], np.concatenate(at, axis=1)
    faces = np.concatenate(pairs)
    through = (np.minimum(at_p, at_q) < -tolerance) & (np.maximum(at_p, at_q) > tolerance)
    level_edge = at_p == at_q
    share = np.where(level_edge, 0.5, np.clip(at_p / np.where(level_edge, 1.0, at_p - at_q), 0.0, 1.0))
    place = p + share[:, None] * (q - p)
    inside = np.full(len(faces), np.inf)
    for corner, after in ((0, 1), (1, 2), (2, 0)):
        here, there = vertices_mm[triangles[faces, corner]], vertices_mm[triangles[faces, after]]
        along = there - here
        inward = np.cross(normal[faces], along)
        length = np.sqrt((along * along).sum(axis=1))
        inside = np.minimum(inside, ((place - here) * inward).sum(axis=1) / length)
    certain = through & (inside > tolerance)
    return place[certain], place[~certain & (inside >= -tolerance)]


def _directions() -> Numbers:
    """Return directions all around, none in a plane that faces of things made by hand lie in."""
    steps = np.array([-1.0, 0.0, 1.0])
    grid = np.stack(np.meshgrid(steps, steps, steps), axis=-1).reshape(-1, 3)
    directions = grid[np.abs(grid).sum(axis=1) > 0] + np.array([0.137, 0.211, 0.293])
    return np.asarray(directions / np.sqrt((directions * directions).sum(axis=1, keepdims=True)))


_DIRECTIONS = _directions()


def _winding_numbers(vertices_mm: Numbers, faces: Indices, points_mm: Numbers) -> Numbers:
    """Return how often a surface goes around points: its solid angles (Van Oosterom and Strackee 1983)."""
    found = np.empty(len(points_mm))
    for index, point in enumerate(points_mm):
        away = vertices_mm - point
        far = np.sqrt((away * away).sum(axis=1))
        (a, b, c), (la, lb, lc) = away[faces.T], far[faces.T]
        volume = (a * np.cross(b, c)).sum(axis=1)
        base = la * lb * lc + (a * b).sum(axis=1) * lc + (b * c).sum(axis=1) * la + (c * a).sum(axis=1) * lb
        found[index] = np.arctan2(volume, base).sum() / (2 * np.pi)
    return found
