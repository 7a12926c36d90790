"""Packing: everything is placed once, inside a plate, on cells that nothing else has."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tactile_toolkit.printing.packing import Spot, pack

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


@settings(max_examples=40)
@given(given_shapes=shapes())
def test_no_cell_is_used_twice_and_every_shape_is_placed_once(given_shapes: list[np.ndarray]) -> None:
    plates = pack(given_shapes, PLATE)
    assert sorted(spot.shape for plate in plates for spot in plate) == list(range(len(given_shapes)))
    assert all(taken(plate, given_shapes).max() == 1 for plate in plates)
    assert pack(given_shapes, PLATE) == plates


@settings(max_examples=20)
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
