"""Packing: every object is placed once, apart from others, within the margins and beside unusable corners."""

from __future__ import annotations

import itertools

import pytest
from hypothesis import given, strategies as st

from tactile_toolkit.errors import InputError
from tactile_toolkit.printing.plate_layouts import Outline, PlacedObject, arrange
from tactile_toolkit.printing.print_options import PlateSpec
from tests.tactile_toolkit.printing.solids import box, ell, named, ring

Box = tuple[float, float, float, float]


def box_of(placed: PlacedObject, grown_mm: float = 0.0) -> Box:
    width_mm, depth_mm = placed.outline.size_mm
    left, front = placed.x_mm - grown_mm, placed.y_mm - grown_mm
    return left, front, placed.x_mm + width_mm + grown_mm, placed.y_mm + depth_mm + grown_mm


def overlap(one: Box, other: Box) -> bool:
    across = min(one[2], other[2]) - max(one[0], other[0])
    along = min(one[3], other[3]) - max(one[1], other[1])
    return min(across, along) > 1e-6


@given(
    sizes=st.lists(st.tuples(st.floats(1, 60), st.floats(1, 50)), min_size=1, max_size=12),
    gap_mm=st.sampled_from([0.0, 0.7, 5.5]),
    margin_mm=st.sampled_from([0.0, 3.3]),
    corner_mm=st.sampled_from([(0.0, 0.0), (18.0, 28.0), (30.0, 5.0)]),
)
def test_boxes_keep_apart_within_the_plate_and_out_of_its_corner(sizes, gap_mm, margin_mm, corner_mm):
    spec = PlateSpec(100, 90, gap_mm, margin_mm, corner_mm)
    layout = arrange(named([box(*size) for size in sizes]), spec)
    placed = [each for plate in layout.plates for each in plate]
    assert sorted(each.item.id for each in placed) == list(range(len(sizes)))
    assert max(layout.shares) <= 1 + 1e-9
    corner = (0.0, 0.0, corner_mm[0] + margin_mm, corner_mm[1] + margin_mm)
    for plate in layout.plates:
        for one, other in itertools.combinations(plate, 2):
            assert not overlap(box_of(one, gap_mm / 2), box_of(other, gap_mm / 2))
        for each in plate:
            left, front, right, back = box_of(each)
            assert min(left, front) >= margin_mm - 1e-6
            assert right <= 100 - margin_mm + 1e-6
            assert back <= 90 - margin_mm + 1e-6
            assert not (any(corner_mm) and overlap(corner, box_of(each)))


def test_the_same_objects_are_laid_out_alike_and_tiles_fill_a_plate() -> None:
    objects = named([box(20, 15), box(10, 30), box(20, 15), ell(25, 6)])
    one, other = (arrange(objects, PlateSpec(60, 60, 2, 0)).plates for _ in range(2))
    assert [[box_of(each) for each in plate] for plate in one] == [
        [box_of(each) for each in plate] for plate in other
    ]
    tiles = arrange(named([box(31, 24) for _ in range(18)]), PlateSpec(99, 78, 3, 0))
    assert [len(plate) for plate in tiles.plates] == [9, 9]
    assert tiles.shares == pytest.approx((1.0, 1.0))
    assert arrange([], PlateSpec()).plates == ()


@pytest.mark.parametrize(("size_mm", "fits"), [((82, 100), True), ((100, 72), True), ((83, 73), False)])
def test_an_object_fits_beside_a_corner_or_behind_it(size_mm: tuple[int, int], fits: bool) -> None:
    spec = PlateSpec(100, 100, 3, 0, (18, 28))
    if fits:
        ((placed,),) = arrange(named([box(*size_mm)]), spec).plates
        assert placed.x_mm >= 18 - 1e-6 or placed.y_mm >= 28 - 1e-6
        return
    with pytest.raises(InputError, match=r"does not fit on the plate.*18 x 28 mm in a corner"):
        arrange(named([box(*size_mm)]), spec)


@pytest.mark.parametrize("mesh", [box(20, 10), ell(30, 8), ring(12, 6)])
def test_an_outline_has_the_area_of_the_shadow(mesh) -> None:
    manifold = mesh.to_manifold().translate((100, -40, 3))
    outline = Outline.of(manifold)
    low = manifold.bounding_box()
    assert outline.low_mm == pytest.approx(low[:2])
    assert outline.size_mm == pytest.approx((low[3] - low[0], low[4] - low[1]))
    assert min(ring.min() for ring in outline.rings) == pytest.approx(0)
    assert outline.section.area() == pytest.approx(manifold.project().area())
