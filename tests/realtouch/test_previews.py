"""Pictures of touches: pixels are drawn where the gel touched, and contacts are marked."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st
from scipy.spatial.transform import Rotation

import realtouch
from realtouch.touch_options import TouchPreviewSpec
from realtouch.touch_previews import (
    CONTACT,
    SENSING_AREA_M,
    PlacedTouch,
    cell_map,
    draw_grid,
    draw_overlay,
    overlay,
    placed_touches,
    plan_previews,
)
from realtouch.touches.rounds import Touch
from tactile_toolkit.errors import InputError
from tests.realtouch import factories
from tests.realtouch.conftest import SIZE, TOUCHES
from tests.realtouch.factories import Layout, RoundTruth

GREY = 128


def gel(angle_deg: float, flipped: bool) -> Rotation:
    """Return the pose of a gel that looks down (flipped) or up, turned about z."""
    down = Rotation.from_euler("x", 180, degrees=True) if flipped else Rotation.identity()
    return Rotation.from_euler("z", angle_deg, degrees=True) * down


def placed(pixels: np.ndarray, centre_m: tuple[float, float], pose: Rotation) -> PlacedTouch:
    axes = pose.apply([[1.0, 0.0, 0.0], [0.0, -1.0, 0.0]])[:, :2]
    return PlacedTouch(pixels, np.array(centre_m), axes)


def felt_at_m(
    pose: Rotation, centre_m: tuple[float, float], column: float, row: float, size: tuple[int, int]
) -> np.ndarray:
    """Return the position of a pixel of the picture on the gel: columns along its +x, rows along its -y."""
    width, height = size
    x = (column / width - 0.5) * SENSING_AREA_M[0]
    y = -(row / height - 0.5) * SENSING_AREA_M[1]
    return np.array(centre_m) + pose.apply([x, y, 0.0])[:2]


@settings(max_examples=settings.default.max_examples // 10)
@given(
    st.floats(-180, 180),
    st.booleans(),
    st.tuples(st.floats(-0.05, 0.05), st.floats(-0.05, 0.05)),
    st.tuples(st.integers(20, 290), st.integers(20, 210)),
)
def test_pixels_are_drawn_at_their_positions(angle, flipped, centre_m, mark):
    column, row = mark
    pixels = np.full((240, 320, 3), GREY, np.uint8)
    pixels[row : row + 12, column : column + 12] = (255, 0, 0)
    pose = gel(angle, flipped)
    touch = placed(pixels, centre_m, pose)
    cell = cell_map([touch], 8.0)
    drawn = overlay([touch], cell)
    x, y = cell.point_px(felt_at_m(pose, centre_m, column + 6, row + 6, (320, 240)))
    assert drawn[int(y), int(x)].tolist() == [255, 0, 0]
    rows, columns = np.nonzero((drawn == (255, 0, 0)).all(axis=2))
    assert (columns.mean() + 0.5, rows.mean() + 0.5) == pytest.approx((x, y), abs=0.5)
    covered = (drawn != 255).any(axis=2).sum()
    assert covered == pytest.approx(SENSING_AREA_M[0] * SENSING_AREA_M[1] * 8000.0**2, rel=0.02)


@pytest.mark.parametrize("kind", ["seq", "single"])
def test_stored_touches_are_placed_by_the_measured_pose(kind, seq_folder, single_folder, truth):
    record = realtouch.load(str(seq_folder if kind == "seq" else single_folder), "train")[1]
    for touch, one in enumerate(placed_touches(record, range(TOUCHES))):
        known = truth[1].touches[touch]
        frame = known.contact_end if kind == "seq" else known.peak
        assert one.centre_m == pytest.approx(known.position_m[frame, :2])
        assert np.array_equal(one.pixels, Touch(record, touch).image)
        # The gel looks down: rows of the picture grow along +y of the cell.
        assert one.axes == pytest.approx(np.eye(2), abs=0.02)
    drawing = draw_overlay(record)
    assert drawing.shape[0] > 120 * 7


def test_without_poses_the_intended_position_is_taken(tmp_path: Path, truth: list[RoundTruth]) -> None:
    layout = Layout(leave_out=("gel_pose_cell_frame.position", "gel_pose_cell_frame.quaternion"))
    folder = factories.write_set(tmp_path, {"train": factories.single_rows(truth)}, "single", layout)
    record = realtouch.load(str(folder))[0]
    for touch, one in enumerate(placed_touches(record, range(TOUCHES))):
        assert one.centre_m == pytest.approx(truth[0].pos_in_cell_m[touch])
        assert one.axes.tolist() == [[1, 0], [0, -1]]
    assert (draw_grid(record, 5) == CONTACT).all(axis=2).sum() == 0


# ---------------------------------------------------------------- rounds


@pytest.mark.parametrize("kind", ["seq", "single"])
def test_touches_that_met_the_digit_are_framed_in_the_grid(kind, seq_folder, single_folder, truth):
    record = realtouch.load(str(seq_folder if kind == "seq" else single_folder), "train")[0]
    pixels = draw_grid(record, 32)
    step = 160 + 6 + 8
    for touch, known in enumerate(truth[0].touches):
        column = pixels[:, 16 + touch * step + 1]
        framed = bool((column == CONTACT).all(axis=1).sum() >= 120)
        assert framed == known.on_digit
    fewer = draw_grid(record, 2)
    assert (fewer == CONTACT).all(axis=2).any()
    assert fewer.shape[1] != 0


def test_plans_name_the_round(seq_folder: Path) -> None:
    plan = plan_previews(str(seq_folder), TouchPreviewSpec(("grid", "overlay"), "train", round_number=2))
    stem = f"{seq_folder.name}-train"
    assert [picture.name for picture in plan.pictures] == [
        f"{stem}-round-2-grid.png",
        f"{stem}-round-2-overlay.png",
    ]
    for picture in plan.pictures:
        assert np.array_equal(picture.draw(), picture.draw())
    assert len(plan_previews(str(seq_folder), TouchPreviewSpec(("all",), "train")).pictures) == 2
    for kinds, spec, words in (
        (("grid",), {"round_number": 3}, "round_number is 3; split 'train' has rounds 0 to 2"),
        (("strip",), {}, "no pictures of kind 'strip'; expected grid, overlay or all"),
    ):
        with pytest.raises(InputError, match=words):
            plan_previews(str(seq_folder), TouchPreviewSpec(kinds, "train", **spec))
    assert SIZE == (96, 72)


def test_a_round_without_touches_is_drawn_as_an_empty_grid(tmp_path: Path) -> None:
    rows = factories.single_rows([factories.make_round(0, 0)])
    factories.write_set(tmp_path, {"train": rows}, "single", Layout(fixed=False))
    (record,) = realtouch.load(tmp_path, "train")
    assert record.touch_count == 0
    assert draw_grid(record, 4).ndim == 3
