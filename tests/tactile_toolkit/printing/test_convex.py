"""Convex parts contain the solid, add little volume, and are the same each time."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial import ConvexHull

import mnist3d
from mnist3d.sources.synthetic import SyntheticSource
from tactile_toolkit.mesh import Mesh
from tactile_toolkit.printing.simulator import convex_parts
from tests.tactile_toolkit.printing.solids import box, ell, mesh_of, prism, ring


def outside_mm(mesh: Mesh, parts: list[Mesh]) -> float:
    """Return the greatest distance of a corner, or of the centre of a face, from the nearest part."""
    vertices = np.asarray(mesh.vertices_m, np.float64)
    points_mm = 1e3 * np.concatenate([vertices, vertices[mesh.faces].mean(axis=1)])
    nearest = np.full(len(points_mm), np.inf)
    for part in parts:
        planes = ConvexHull(1e3 * np.asarray(part.vertices_m)).equations
        nearest = np.minimum(nearest, (points_mm @ planes[:, :3].T + planes[:, 3]).max(axis=1))
    return float(nearest.max())


# The last one has a stroke that swells: its outline has no bay, and yet its hull adds a tenth.
@pytest.mark.one_at_a_desk
@pytest.mark.parametrize(("seed", "number"), [(2, 3), (2, 1000), (2, 13000), (0, 10449)])
def test_parts_of_a_digit(seed: int, number: int):
    solid = mnist3d.solidify(SyntheticSource(seed=seed).image(number).pixels)
    parts = convex_parts(solid)
    hulls = [ConvexHull(part.vertices_m).volume for part in parts]
    # On a processor without AVX-512, manifold3d 3.5.4 makes one of 107 hulls 0.03 % larger than that of its
    # corners, as Qhull finds it however they are turned. Simulators take the hull of the corners.
    assert [part.volume_m3 for part in parts] == pytest.approx(hulls, rel=1e-3), "a part is not convex"
    assert 0.99 <= sum(hulls) / solid.volume_m3 <= 1.10
    assert outside_mm(solid, parts) <= 0.3
    again = convex_parts(solid)
    assert all((one.vertices_m == other.vertices_m).all() for one, other in zip(parts, again, strict=True))


def test_convex_solids_are_one_part():
    (part,) = convex_parts(box(20, 10))
    assert part.volume_m3 == pytest.approx(box(20, 10).volume_m3)


def test_bays_holes_and_several_bodies():
    assert len(convex_parts(ell(30, 8))) == 2
    assert len(convex_parts(prism([(0, 0), (40, 0), (40, 10), (8, 3), (0, 15)]))) == 2, "cut in its bay"
    hollow = ring(12, 6)
    parts = convex_parts(hollow)
    assert sum(part.volume_m3 for part in parts) <= 1.08 * hollow.volume_m3
    assert outside_mm(hollow, parts) <= 0.3
    assert len(convex_parts(hollow, most=3)) in (3, 4), "the last cut may leave more than two"
    far = Mesh(box(5, 5).vertices_m + 0.1, box(5, 5).faces + len(box(4, 4).vertices_m))
    both = Mesh(
        np.concatenate([box(4, 4).vertices_m, far.vertices_m]), np.concatenate([box(4, 4).faces, far.faces])
    )
    assert len(convex_parts(both)) == 2


def test_cuts_lie_in_steps_of_15_degrees():
    """A block with a notch 10 degrees wide: only cuts along its middle or across its tip leave no bay."""
    aside_mm = 20 * np.tan(np.radians(5))
    notch = [(aside_mm, 30), (0, 10), (-aside_mm, 30)]
    upright = prism([(-10, 0), (10, 0), (10, 30), *notch, (-10, 30)]).to_manifold()
    for turned_deg in range(0, 180, 15):
        turned = mesh_of(upright.rotate((0, 0, turned_deg)))
        parts = convex_parts(turned, excess=1.002)
        assert len(parts) in (2, 3), turned_deg
        assert sum(part.volume_m3 for part in parts) == pytest.approx(turned.volume_m3, rel=1e-6)


def test_solids_that_vertical_cuts_cannot_divide_end():
    """A flight of low steps under a convex outline: after each cut, hulls still add volume."""
    steps = [(x, 2 + x % 2) for x in range(40)]
    upright = prism([(0, 0), (39, 0), *reversed(steps)])
    turned = Mesh(np.asarray(upright.vertices_m)[:, [2, 0, 1]], upright.faces)
    assert turned.volume_m3 > 0
    parts = convex_parts(turned, excess=1.0)
    assert outside_mm(turned, parts) <= 0.3
    assert len(parts) <= 2 * 64
