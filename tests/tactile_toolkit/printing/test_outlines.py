"""Outlines and the cells that they touch."""

from __future__ import annotations

import math

import manifold3d
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tactile_toolkit.printing.packing import PlateSpec, cells_touched, outline_of
from tests.tactile_toolkit.printing.solids import box, ell, ring


def exact_cells(section: manifold3d.CrossSection, shape: tuple[int, int]) -> np.ndarray:
    """Ask for the area of each cell inside the polygon, one by one."""
    unit = manifold3d.CrossSection.square((1, 1))
    return np.array(
        [
            [(unit.translate((column, row)) ^ section).area() > 1e-9 for column in range(shape[1])]
            for row in range(shape[0])
        ]
    )


@settings(max_examples=30)
@given(
    corners=st.integers(3, 9),
    seed=st.integers(0, 2**32),
    hole=st.booleans(),
)
def test_cells_cover_all_that_a_polygon_grown_by_the_slack_covers(
    corners: int, seed: int, hole: bool
) -> None:
    rng = np.random.default_rng(seed)
    angles = np.sort(rng.uniform(0, 2 * math.pi, corners))
    star = np.c_[np.cos(angles), np.sin(angles)] * rng.uniform(2, 7, (corners, 1)) + 8
    section = manifold3d.CrossSection([star], manifold3d.FillRule.NonZero)
    if hole:
        section = section - manifold3d.CrossSection.circle(1.3, 16).translate((8, 8))
    rings = section.offset(1 / 16, manifold3d.JoinType.Round).to_polygons()
    if not rings:
        return
    found = cells_touched([np.asarray(ring) for ring in rings], (16, 16))
    needed = exact_cells(section, (16, 16))
    assert (found >= needed).all()
    wider = section.offset(1 / 16 + 1e-6, manifold3d.JoinType.Round)
    assert (found <= exact_cells(wider, (16, 16))).all()


@pytest.mark.parametrize("mesh", [box(20, 10), ell(30, 8), ring(12, 6)])
def test_an_outline_has_the_area_of_the_shadow(mesh) -> None:
    manifold = mesh.to_manifold().translate((100, -40, 3))
    outline = outline_of(manifold)
    low = manifold.bounding_box()
    assert outline.low_mm == pytest.approx(low[:2])
    assert outline.size_mm == pytest.approx((low[3] - low[0], low[4] - low[1]))
    assert min(ring.min() for ring in outline.rings) == pytest.approx(0)
    assert outline.grown(0).area() == pytest.approx(manifold.project().area())


def test_growing_reaches_all_around() -> None:
    outline = outline_of(box(20, 10).to_manifold())
    exact = 20 * 10 + 2 * 3 * (20 + 10) + math.pi * 9
    assert exact <= outline.grown(3).area() < exact * 1.002


def test_an_object_as_large_as_the_plate_needs_all_of_it_and_no_more() -> None:
    for gap_mm in (0.0, 3.0, 7.3):
        spec = PlateSpec(120.0, 87.3, gap_mm)
        cells = spec.cells_of(outline_of(box(120, 87.3).to_manifold()))
        assert cells.shape == spec.cells
