"""The thinnest wall anywhere in a solid: the smallest ball between stretches of surface that face each other.

They face each other where the way from one to the other starts into the solid nearly at right angles to the
surface, on both sides; or at an edge that points into the solid, as that of a notch, where every way along
the surface leads further apart. The two sides of an outer edge sharper than twice the angle of
:data:`FACING` face each other, those of blunter edges do not. Triangles with a common corner never do.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from tactile_toolkit.mesh.nearness import near_pairs

__all__ = ["FACING", "thinnest_wall_mm"]

Numbers = NDArray[np.float64]
Indices = NDArray[np.int64]

FACING = 0.95
"""Least cosine between the way across a wall and the direction into the solid: 18 degrees."""

# Shares of the reach that are searched one after the other: the fewer pairs, the nearer they have to be.
_STEPS = (0.06, 0.16, 0.4, 1.0)

# What is found is accepted when nothing is nearer than this share of it.
_CLOSER = 0.97

# Triangles smaller than this share of their distance are taken at their middles.
_FINE = 0.25

# Cosine of the angle from which on an edge that points into the solid is a notch: 16 degrees.
_NOTCH = 0.96

# Cosine up to which a way along the surface counts as leading no nearer.
_ALONG = 0.05


def thinnest_wall_mm(vertices_mm: Numbers, faces: Indices, reach_mm: float) -> float:
    """Return the thinnest wall of a closed manifold mesh, up to a reach; infinity where there is none."""
    surface = _Surface(vertices_mm, faces)
    found = np.inf
    for share in _STEPS:
        found = surface.first_within(share * reach_mm)
        if found < np.inf:
            break
    while found < np.inf and (closer := surface.first_within(_CLOSER * found)) < np.inf:
        found = closer
    return found


class _Surface:
    """Triangles, what directions lead into the solid, and which edges they share."""

    def __init__(self, vertices_mm: Numbers, faces: Indices) -> None:
        a, b, c = (vertices_mm[faces[:, corner]] for corner in range(3))
        outward = np.cross(b - a, c - a)
        area = np.sqrt((outward * outward).sum(axis=1))
        # Triangles without area face nowhere.
        kept = area > 0
        self.points, self.faces = vertices_mm, faces[kept]
        self.inward = -outward[kept] / area[kept, None]
        sums = np.stack(
            [
                np.bincount(self.faces.ravel(), np.repeat(weighed, 3), minlength=len(vertices_mm))
                for weighed in -outward[kept].T
            ],
            axis=1,
        )
        self.inward_at_corner = sums / np.maximum(np.sqrt((sums * sums).sum(axis=1, keepdims=True)), 1e-300)
        corners = vertices_mm[self.faces]
        self.middle = corners.mean(axis=1)
        self.size = np.sqrt(((corners - self.middle[:, None]) ** 2).sum(axis=2).max(axis=1))
        self.level = (corners[:, 0] * self.inward).sum(axis=1)
        start, end = self.faces[:, [0, 1, 2]].ravel(), self.faces[:, [1, 2, 0]].ravel()
        keys = np.minimum(start, end) * len(vertices_mm) + np.maximum(start, end)
        names, first, self.edge_of = np.unique(keys, return_index=True, return_inverse=True)
        last = np.empty(len(names), np.int64)
        last[self.edge_of] = np.arange(len(keys))
        self.edges = np.stack([start[first], end[first]], axis=1)
        # Of each edge, on both sides: into the solid, and away from the edge along the surface.
        along = self.points[end] - self.points[start]
        along /= np.maximum(np.sqrt((along * along).sum(axis=1, keepdims=True)), 1e-300)
        sides = np.repeat(self.inward, 3, axis=0)
        away = np.cross(along, sides)
        self.edge_sides = [(sides[side], away[side]) for side in (first, last)]
        self.along = along[first]
        (inward, _), (beyond, away_beyond) = self.edge_sides
        notch = ((inward * beyond).sum(axis=1) < _NOTCH) & ((inward * away_beyond).sum(axis=1) < 0)
        self.edge_of = self.edge_of.reshape(-1, 3)
        self.notched = notch[self.edge_of].any(axis=1)

    def first_within(self, within_mm: float) -> float:
        """Return the least distance of the first pairs that face each other within a distance."""
        for one, other in near_pairs(self.points[self.faces], within_mm, self.inward):
            found = self._nearest(*self._before_each_other(one, other, within_mm), within_mm)
            if found <= within_mm:
                return found
        return float(np.inf)

    def _before_each_other(self, one: Indices, other: Indices, within_mm: float) -> tuple[Indices, Indices]:
        """Keep pairs without a common corner of which each has something of the other before it."""
        for first, second in ((0, 1), (1, 0)):
            pair = (one, other)
            planes, corners = self.inward[pair[first]], self.faces[pair[second]].T
            level = self.level[pair[first]]
            depth = [(self.points[corner] * planes).sum(axis=1) - level for corner in corners]
            before = (np.maximum.reduce(depth) > 0) & (np.minimum.reduce(depth) <= within_mm)
            one, other = one[before], other[before]
        shared = (self.faces[one][:, :, None] == self.faces[other][:, None, :]).any(axis=(1, 2))
        return one[~shared], other[~shared]

    def _nearest(self, one: Indices, other: Indices, within_mm: float) -> float:
        """Return the least distance at which triangles of pairs face each other."""
        way = self.middle[other] - self.middle[one]
        distance = np.sqrt((way * way).sum(axis=1))
        fine = self.size[one] + self.size[other] < _FINE * distance
        fine &= ~(self.notched[one] | self.notched[other])
        across = distance[fine]
        cosines = [
            sign * (way[fine] * self.inward[named[fine]]).sum(axis=1) / across
            for sign, named in ((1, one), (-1, other))
        ]
        cosine = np.minimum.reduce(cosines)
        # The ball that touches the surface on both sides is wider than the way where that is aslant.
        faced = cosine >= FACING
        found = float((across[faced] / cosine[faced]).min(initial=np.inf))
        one, other = one[~fine], other[~fine]
        found = min(found, self._from_corners(one, other), self._from_corners(other, one))
        edges, others = (self.edge_of[named] for named in (one, other))
        count = len(self.edges)
        keys = np.unique((edges[:, :, None] * count + others[:, None, :]).ravel())
        return min(found, self._between_edges(keys // count, keys % count, within_mm))

    def _from_corners(self, one: Indices, other: Indices) -> float:
        """Return the least distance from a corner of the one triangle straight to the inside of the other."""
        least = np.inf
        base, inward = self.points[self.faces[other]], self.inward[other]
        for corner in self.faces[one].T:
            point = self.points[corner]
            depth = ((point - base[:, 0]) * inward).sum(axis=1)
            facing = np.maximum(
                -(self.inward[one] * inward).sum(axis=1),
                -(self.inward_at_corner[corner] * inward).sum(axis=1),
            )
            chosen = np.flatnonzero((depth > 0) & (facing >= FACING))
            for start, end in ((0, 1), (1, 2), (2, 0)):
                along = base[chosen, end] - base[chosen, start]
                side = (np.cross(along, inward[chosen]) * (point[chosen] - base[chosen, start])).sum(axis=1)
                chosen = chosen[side >= -1e-9 * (along * along).sum(axis=1)]
            least = min(least, float((depth[chosen] / facing[chosen]).min(initial=np.inf)))
        return least

    def _between_edges(self, one: Indices, other: Indices, within_mm: float) -> float:
        """Return the least distance between edges that face each other."""
        (p, p_end), (q, q_end) = (self.points[self.edges[named]].transpose(1, 0, 2) for named in (one, other))
        u, v, r = p_end - p, q_end - q, p - q
        uu, vv, uv = (u * u).sum(axis=1), (v * v).sum(axis=1), (u * v).sum(axis=1)
        ur, vr = (u * r).sum(axis=1), (v * r).sum(axis=1)
        slant = uu * vv - uv * uv
        skew = slant > 1e-12 * uu * vv
        s = np.where(skew, np.clip((uv * vr - ur * vv) / np.where(skew, slant, 1.0), 0, 1), 0.5)
        t = np.clip((uv * s + vr) / vv, 0, 1)
        s = np.clip((uv * t - ur) / uu, 0, 1)
        way = (q + t[:, None] * v) - (p + s[:, None] * u)
        distance = np.sqrt((way * way).sum(axis=1))
        near = np.flatnonzero((distance > 0) & (distance <= within_mm))
        way = way[near] / distance[near, None]
        cosine = np.minimum(self._cosine_in(one[near], way), self._cosine_in(other[near], -way))
        faced = cosine >= FACING
        return float((distance[near][faced] / cosine[faced]).min(initial=np.inf))

    def _cosine_in(self, edge: Indices, way: Numbers) -> Numbers:
        """Return how straight ways that start at edges lead into the solid; 1 at an edge that is a notch."""
        cosines = [(inward[edge] * way).sum(axis=1) for inward, _ in self.edge_sides]
        along = [(away[edge] * way).sum(axis=1) for _, away in self.edge_sides]
        notch = (np.maximum.reduce(along) <= _ALONG) & (np.minimum.reduce(cosines) > 0)
        notch &= np.abs((self.along[edge] * way).sum(axis=1)) <= np.sqrt(1 - FACING**2)
        return np.where(notch, 1.0, np.maximum.reduce(cosines))
