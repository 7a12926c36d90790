"""Packing: cells hold all of an outline, and everything is placed once, on cells that nothing else has."""

from __future__ import annotations

import math

import manifold3d
import numpy as np
import pytest
from hypothesis import given, settings, strategies as st

from tactile_toolkit.printing import PlateSpec
from tactile_toolkit.printing.packing import Spot, cells_of, cells_touched, outline_of, pack
from tests.tactile_toolkit.printing.solids import box, ell, ring

PLATE = (24, 30)


@st.composite
def shapes(draw: st.DrawFn) -> list[np.ndarray]:
    made = []
    for _ in range(draw(st.integers(1, 14))):
        rows, columns = draw(st.integers(1, PLATE[0])), draw(st.integers(1, 12))
        noise = np.random.default_rng(draw(st.integers(0, 2**32))).random((rows, columns))
        cells = noise < draw(st.sampled_from([0.3, 0.7, 1.0]))
        cells[draw(st.integers(0, rows - 1)), draw(st.integers(0, columns - 1))] = True
        made.append(cells)
    return made


def taken(plate: list[Spot], given_shapes: list[np.ndarray]) -> np.ndarray:
    cells = np.zeros(PLATE, int)
    for spot in plate:
        shape = given_shapes[spot.shape]
        rows, columns = shape.shape
        assert spot.row >= 0
        assert spot.column >= 0
        # A shape that reached over the edge would not broadcast.
        cells[spot.row : spot.row + rows, spot.column : spot.column + columns] += shape
    return cells


@given(given_shapes=shapes())
def test_no_cell_is_used_twice_and_every_shape_is_placed_once(given_shapes: list[np.ndarray]) -> None:
    plates = pack(given_shapes, PLATE)
    assert sorted(spot.shape for plate in plates for spot in plate) == list(range(len(given_shapes)))
    assert all(taken(plate, given_shapes).max() == 1 for plate in plates)
    assert pack(given_shapes, PLATE) == plates


@settings(max_examples=settings.default.max_examples // 5)
@given(given_shapes=shapes())
def test_no_plate_is_opened_while_a_shape_fits_on_an_earlier_one(given_shapes: list[np.ndarray]) -> None:
    plates = pack(given_shapes, PLATE)
    for number, plate in enumerate(plates):
        free = taken(plate, given_shapes) == 0
        for spot in (spot for later in plates[number + 1 :] for spot in later):
            shape = given_shapes[spot.shape]
            rows, columns = shape.shape
            places = np.lib.stride_tricks.sliding_window_view(free, shape.shape)[:, :, shape]
            assert not places.all(axis=-1).any(), (rows, columns)


def test_bays_and_holes_are_used() -> None:
    frame = np.ones((20, 20), bool)
    frame[3:17, 3:17] = False
    block = np.ones((14, 14), bool)
    (plate,) = pack([frame, block], (20, 20))
    assert set(plate) == {Spot(0, 0, 0), Spot(1, 3, 3)}


def test_tiles_fill_plates_to_the_last_cell() -> None:
    tiles = [np.ones((5, 5), bool)] * 24
    assert [len(plate) for plate in pack(tiles, (20, 15), least_plates=2)] == [12, 12]


def test_nothing_needs_no_plate() -> None:
    assert pack([], PLATE) == []


def test_progress_ends_at_its_total() -> None:
    told: list[tuple[int, int]] = []
    pack([np.ones((4, 4), bool)] * 5, PLATE, on_progress=lambda done, total: told.append((done, total)))
    assert told[-1][0] == told[-1][1]
    assert told == sorted(told)


@pytest.mark.parametrize("count", [1, 7])
def test_a_shape_as_large_as_the_plate_has_one_of_its_own(count: int) -> None:
    assert [len(plate) for plate in pack([np.ones(PLATE, bool)] * count, PLATE)] == [1] * count


def exact_cells(section: manifold3d.CrossSection, shape: tuple[int, int]) -> np.ndarray:
    """Ask for the area of each cell inside the polygon, one by one."""
    unit = manifold3d.CrossSection.square((1, 1))
    return np.array(
        [
            [(unit.translate((column, row)) ^ section).area() > 1e-9 for column in range(shape[1])]
            for row in range(shape[0])
        ]
    )


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
    # manifold3d rounds to millionths: a cell that the polygon only touches has no area that can be measured.
    wider = section.offset(1 / 16 + 1e-4, manifold3d.JoinType.Round)
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
        spec = PlateSpec(120.0, 87.3, gap_mm, 0.0)
        cells = cells_of(spec, outline_of(box(120, 87.3).to_manifold()))
        assert cells.shape == spec.cells


def test_progress_counts_every_shape_that_is_placed() -> None:
    told: list[int] = []
    pack([np.ones((4, 4), bool)] * 5, PLATE, on_progress=lambda done, _total: told.append(done))
    assert told[:5] == [1, 2, 3, 4, 5]
