"""Whether the surface of a body crosses itself: edges against triangles, over a tree of boxes.

Where two sheets of a closed surface cross there is space that is enclosed twice, or inside out, and the
volume counts it so. Sheets that only touch enclose nothing twice and are left alone.

Generic sheets cross where an edge passes through a triangle with which it shares no corner. An edge that meets
a triangle only within :func:`tolerance_mm` of its ends, or of the rim of the triangle, may touch it or be the
seam of a crossing: there the winding numbers of points around it tell.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np
from numpy.typing import NDArray

__all__ = ["self_crossing", "tolerance_mm"]

Numbers = NDArray[np.float64]
Indices = NDArray[np.int64]

_TOLERANCE = 2.0**-21
_AT_ONCE = 1 << 17
"""Pairs that are looked at together: bounds the memory."""

_MOST_ODD = 64
_DOUBTS_ASKED = 32
_ASIDE = 16.0
"""How many tolerances from a doubtful place the winding number is asked for."""


def tolerance_mm(vertices_mm: Numbers) -> float:
    """Return how deep sheets may lie in one another: four times what storing single precision may move them."""
    return _TOLERANCE * float(np.abs(vertices_mm).max())


def self_crossing(vertices_mm: Numbers, faces: NDArray[np.integer[Any]]) -> Numbers | None:
    """Return a place, shape (3,), where a closed manifold surface crosses itself; None where it does not.

    Several bodies count as one surface.
    """
    faces = faces.astype(np.int64)
    suspects = _not_proven_free(vertices_mm, faces)
    if not len(suspects):
        return None
    return _crossing_among(vertices_mm, faces, suspects)


# --- proof for what is made of two reliefs back to back -------------------------------------------


def _not_proven_free(vertices_mm: Numbers, faces: Indices) -> Indices:
    """Return the faces that may cross others; fewer than all where the surface splits along a level plane.

    Over any point of the plane the upper half has as many more faces that look up than faces that do not as
    its rim winds around the point. If the rim is simple that is at most one: then no two faces share a point
    unless one lies there that does not look up, and of these there are few.
    """
    everything = np.arange(len(faces))
    heights = vertices_mm[:, 2]
    corners = heights[faces]
    level = (heights.max() + heights.min()) / 2
    above = corners.min(axis=1) >= level
    if np.array_equal(above, corners.max(axis=1) <= level) or not (above ^ (corners.max(axis=1) <= level)).all():
        return everything
    x, y = vertices_mm[:, 0], vertices_mm[:, 1]
    low_x, low_y = x[faces], y[faces]
    (ax, bx, cx), (ay, by, cy) = low_x.T, low_y.T
    facing = (bx - ax) * (cy - ay) - (by - ay) * (cx - ax)
    odd = np.flatnonzero(np.where(above, facing, -facing) <= 0)
    if len(odd) > _MOST_ODD or not _rim_is_simple(vertices_mm, faces[above], level):
        return everything
    if not len(odd):
        return odd
    least = np.stack([low_x.min(axis=1), low_y.min(axis=1)])
    most = np.stack([low_x.max(axis=1), low_y.max(axis=1)])
    near = np.zeros(len(faces), dtype=bool)
    for face in odd:
        near |= ((least <= most[:, face, None]) & (most >= least[:, face, None])).all(axis=0)
    return np.flatnonzero(near)


def _rim_is_simple(vertices_mm: Numbers, upper: Indices, level: float) -> bool:
    """Tell whether the rim of the upper half is closed lines apart from each other that wind once at most."""
    on_level = vertices_mm[:, 2] == level
    ends = upper[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2)
    ends = ends[on_level[ends].all(axis=1)]
    keys, others = ends[:, 0] * len(vertices_mm) + ends[:, 1], ends[:, 1] * len(vertices_mm) + ends[:, 0]
    rim = ends[~np.isin(keys, others)]
    starts = rim[:, 0]
    if len(np.unique(starts)) != len(starts):
        return False
    p, q = vertices_mm[rim[:, 0], :2], vertices_mm[rim[:, 1], :2]
    order = np.argsort(np.minimum(p[:, 0], q[:, 0]), kind="stable")
    rim, p, q = rim[order], p[order], q[order]
    low, high = np.minimum(p, q), np.maximum(p, q)
    stops = np.searchsorted(low[:, 0], high[:, 0], side="right")
    count = stops - np.arange(len(rim)) - 1
    one = np.repeat(np.arange(len(rim)), count)
    other = one + 1 + np.arange(len(one)) - np.repeat(np.cumsum(count) - count, count)
    meet = (low[one, 1] <= high[other, 1]) & (low[other, 1] <= high[one, 1])
    one, other = one[meet], other[meet]
    joined = (rim[one, 0] == rim[other, 1]) | (rim[one, 1] == rim[other, 0])
    # Neighbours share their corner; they are apart otherwise unless one runs back along the other.
    a, b, c, d = p[one], q[one], p[other], q[other]
    turn_c, turn_d, turn_a, turn_b = _turn(a, b, c), _turn(a, b, d), _turn(c, d, a), _turn(c, d, b)
    apart = (turn_c * turn_d > 0) | (turn_a * turn_b > 0)
    straight_on = ((b - a) * (d - c)).sum(axis=1) > 0
    bent = (turn_c != 0) | (turn_d != 0)
    if not np.where(joined, bent | straight_on, apart).all():
        return False
    return _winds_once(rim, p, q)


def _turn(a: Numbers, b: Numbers, c: Numbers) -> Numbers:
    return (b[:, 0] - a[:, 0]) * (c[:, 1] - a[:, 1]) - (b[:, 1] - a[:, 1]) * (c[:, 0] - a[:, 0])


def _winds_once(rim: Indices, p: Numbers, q: Numbers) -> bool:
    """Tell whether simple closed lines wind no more than once around any point, and never backwards."""
    from scipy import sparse
    from scipy.sparse import csgraph

    corners, numbers = np.unique(rim, return_inverse=True)
    first, second = numbers.reshape(rim.shape).T
    links = sparse.coo_matrix((np.ones(len(rim), np.int8), (first, second)), shape=(len(corners),) * 2)
    lines, line_of = csgraph.connected_components(links, directed=False)
    line_of = line_of[first]
    for line in range(lines):
        own, rest = line_of == line, line_of != line
        area = (p[own, 0] * q[own, 1] - q[own, 0] * p[own, 1]).sum()
        x, y = p[own][0]
        (ax, ay), (bx, by) = p[rest].T, q[rest].T
        side = (bx - ax) * (y - ay) - (by - ay) * (x - ax)
        winding = ((ay <= y) & (by > y) & (side > 0)).sum() - ((ay > y) & (by <= y) & (side < 0)).sum()
        if winding != (0 if area > 0 else 1):
            return False
    return True


# --- everything else ------------------------------------------------------------------------------


def _crossing_among(vertices_mm: Numbers, faces: Indices, suspects: Indices) -> Numbers | None:
    """Return where faces among the suspects cross each other, if they do."""
    tolerance = tolerance_mm(vertices_mm)
    a, b, c = (vertices_mm[faces[suspects, corner]] for corner in range(3))
    normal = np.cross(b - a, c - a)
    doubled = np.sqrt((normal * normal).sum(axis=1))
    longest = np.sqrt(np.max([((v - u) ** 2).sum(axis=1) for u, v in ((a, b), (b, c), (c, a))], axis=0))
    # What is no wider than the tolerance cannot be passed through; its edges are those of its neighbours, too.
    wide = doubled > tolerance * longest
    suspects, normal = suspects[wide], normal[wide] / doubled[wide, None]
    triangles = faces[suspects]
    doubtful: list[Numbers] = []
    for one, other in _near_pairs(vertices_mm[triangles], tolerance):
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
        if ((winding > 1.25) | (winding < -0.25)).any():
            return np.asarray(place)
    return None


def _passages(
    vertices_mm: Numbers, triangles: Indices, normal: Numbers, target: Indices, passing: Indices, tolerance: float
) -> tuple[Numbers, Numbers]:
    """Return where edges of triangles certainly pass through target triangles, and where they may."""
    origin = vertices_mm[triangles[target, 0]]
    corners = triangles[passing]
    upright = normal[target]
    depth = ((vertices_mm[corners] - origin[:, None]) * upright[:, None]).sum(axis=2)
    shared = (corners[:, :, None] == triangles[target][:, None, :]).any(axis=2)
    after = [1, 2, 0]
    start_mm, end_mm = depth, depth[:, after]
    least, most = np.minimum(start_mm, end_mm), np.maximum(start_mm, end_mm)
    open_ = ~(shared | shared[:, after]) & (least <= tolerance) & (most >= -tolerance)
    pair, edge = np.nonzero(open_)
    if not len(pair):
        return np.zeros((0, 3)), np.zeros((0, 3))
    p, q = (vertices_mm[corners[pair, corner]] for corner in (edge, np.array(after)[edge]))
    at_p, at_q = start_mm[pair, edge], end_mm[pair, edge]
    through = (np.minimum(at_p, at_q) < -tolerance) & (np.maximum(at_p, at_q) > tolerance)
    share = np.clip(at_p / np.where(at_p == at_q, 1.0, at_p - at_q), 0.0, 1.0)
    share = np.where(at_p == at_q, 0.5, share)
    place = p + share[:, None] * (q - p)
    inside = np.full(len(pair), np.inf)
    target_corners, up = vertices_mm[triangles[target[pair]]], upright[pair]
    for corner in range(3):
        here, there = target_corners[:, corner], target_corners[:, after[corner]]
        along = there - here
        inward = np.cross(up, along)
        length = np.sqrt((along * along).sum(axis=1))
        inside = np.minimum(inside, ((place - here) * inward).sum(axis=1) / length)
    certain = through & (inside > tolerance)
    doubtful = ~certain & (inside >= -tolerance)
    return place[certain], place[doubtful]


_DIRECTIONS: Numbers = np.array(
    [(x, y, z) for x in (-1, 0, 1) for y in (-1, 0, 1) for z in (-1, 0, 1) if (x, y, z) != (0, 0, 0)], np.float64
)


def _winding_numbers(vertices_mm: Numbers, faces: Indices, points_mm: Numbers) -> Numbers:
    """Return how often a surface goes around points: solid angles (Van Oosterom and Strackee 1983), added up."""
    found = np.empty(len(points_mm))
    for index, point in enumerate(points_mm):
        away = vertices_mm - point
        far = np.sqrt((away * away).sum(axis=1))
        (a, b, c), (la, lb, lc) = away[faces.T], far[faces.T]
        volume = (a * np.cross(b, c)).sum(axis=1)
        base = la * lb * lc + (a * b).sum(axis=1) * lc + (b * c).sum(axis=1) * la + (c * a).sum(axis=1) * lb
        found[index] = np.arctan2(volume, base).sum() / (2 * np.pi)
    return found


def _near_pairs(corners_mm: Numbers, tolerance: float) -> Iterator[tuple[Indices, Indices]]:
    """Yield pairs of triangles whose boxes meet, some at a time: down a tree of boxes, both branches at once."""
    low, high = corners_mm.min(axis=1) - tolerance / 2, corners_mm.max(axis=1) + tolerance / 2
    order = _along_a_curve((low + high) / 2)
    levels = max(1, int(np.ceil(np.log2(max(len(order), 2)))))
    lows = np.full((1 << levels, 3), np.inf)
    highs = np.full((1 << levels, 3), -np.inf)
    lows[: len(order)], highs[: len(order)] = low[order], high[order]
    tree = [(lows, highs)]
    for _ in range(levels):
        lows, highs = tree[-1]
        tree.append((np.minimum(lows[::2], lows[1::2]), np.maximum(highs[::2], highs[1::2])))
    root = np.zeros(1, np.int64)
    waiting = [(levels, root, root)]
    while waiting:
        level, one, other = waiting.pop()
        if level == 0:
            apart = one != other
            yield order[one[apart]], order[other[apart]]
            continue
        if len(one) > _AT_ONCE:
            half = len(one) // 2
            waiting += [(level, one[half:], other[half:]), (level, one[:half], other[:half])]
            continue
        same = one == other
        left, right = 2 * one, 2 * other
        one = np.concatenate([left, left + 1, left, left[~same] + 1])
        other = np.concatenate([right, right + 1, right + 1, right[~same]])
        lows, highs = tree[level - 1]
        meet = np.ones(len(one), dtype=bool)
        for axis in range(3):
            near, far = lows[:, axis], highs[:, axis]
            meet &= (near[one] <= far[other]) & (near[other] <= far[one])
        waiting.append((level - 1, one[meet], other[meet]))


def _along_a_curve(points: Numbers) -> Indices:
    """Return an order of points in which neighbours are near: that of Morton's curve."""
    low = points.min(axis=0)
    span = max(float((points.max(axis=0) - low).max()), 1e-300)
    cells = ((points - low) * (1023.0 / span)).astype(np.int64)
    for shift, mask in ((16, 0x30000FF), (8, 0x300F00F), (4, 0x30C30C3), (2, 0x9249249)):
        cells = (cells | (cells << shift)) & mask
    return np.argsort(cells[:, 0] | (cells[:, 1] << 1) | (cells[:, 2] << 2), kind="stable")
