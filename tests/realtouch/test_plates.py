"""How contact is known in a set; the height of the plate stays when touches that show it are removed."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from PIL import Image

import realtouch
from realtouch.contact import contact_heights_m
from realtouch.touch_gallery import plan_gallery
from realtouch.touch_previews import CONTACT, draw_grid
from tactile_toolkit.errors import InputError
from tactile_toolkit.touch import PRESS_DEPTH_M
from tests.realtouch import factories
from tests.realtouch.factories import RoundTruth


def plates_m(truth: list[RoundTruth], kind: str) -> np.ndarray:
    """Return the height of the gel in the touch of each round that misses the digit."""
    touches = [each.touches[2] for each in truth]
    return np.array([t.position_m[:, 2].min() if kind == "seq" else t.position_m[t.peak, 2] for t in touches])


def test_a_selection_of_contacts_has_contact(source: Path, truth: list[RoundTruth], tmp_path: Path) -> None:
    before = realtouch.load(source, "train")
    realtouch.select(source, tmp_path / "some", contact=True)
    after = realtouch.load(tmp_path / "some", "train")
    np.testing.assert_array_equal(after.column("plate_z_m"), plates_m(truth, before.kind))
    touches = after.touches()
    assert len(touches) == len(touches.with_contact()) == 12
    np.testing.assert_array_equal(touches.heights_m(), before.touches().with_contact().heights_m())
    np.testing.assert_array_equal(touches.heights_m(False), before.touches().with_contact().heights_m(False))
    assert realtouch.summarise(after).contact_share == 1.0
    assert "100.0 %" in (tmp_path / "some" / "README.md").read_text()
    card = (tmp_path / "some" / "README.md").read_text()
    assert "`plate_z_m`" in card
    assert "do not count" not in card
    items = [item for task in plan_gallery(str(tmp_path / "some")).tasks for item in task.make()]
    assert [(item.values["in_contact"], item.values["contact"]) for item in items] == [(4, "all touches")] * 4
    # The deepest of the remaining touches is in contact too, above the former plate.
    assert (draw_grid(after[0], 4) == CONTACT).all(axis=2).any()
    assert realtouch.verify(tmp_path / "some").ok


@pytest.mark.thorough
@pytest.mark.one_at_a_desk
def test_it_stays_through_further_conversions(source: Path, tmp_path: Path) -> None:
    realtouch.select(source, tmp_path / "some", contact=True)
    realtouch.select(tmp_path / "some", tmp_path / "again", contact=True)
    realtouch.resize(tmp_path / "some", tmp_path / "small", 48, 36)
    folders = [tmp_path / "again", tmp_path / "small"]
    if source.name.startswith("seq"):
        realtouch.clips_to_images(tmp_path / "some", tmp_path / "images", "peak")
        folders.append(tmp_path / "images")
    stored = realtouch.load(tmp_path / "some", "train").column("plate_z_m")
    for folder in folders:
        made = realtouch.load(folder, "train")
        np.testing.assert_array_equal(made.column("plate_z_m"), stored)
        assert len(made.touches().with_contact()) == len(made.touches()) == 12


def test_heights_above_a_known_plate() -> None:
    z_m = np.array([0.003, 0.009, np.nan])
    np.testing.assert_allclose(contact_heights_m(z_m), [0.0, 0.006, np.nan])
    np.testing.assert_allclose(contact_heights_m(z_m, plate_z_m=0.001), [0.002, 0.008, np.nan])
    np.testing.assert_array_equal(contact_heights_m(z_m, False, plate_z_m=0.001), z_m)
    assert np.isnan(contact_heights_m(np.array([np.nan]))).all()
    assert contact_heights_m(np.zeros(0)).shape == (0,)


def test_a_rendered_round_without_a_stored_plate_has_the_known_one(truth, tmp_path):
    """Joined sets may store the height of the plate for some rounds only; null is NaN in numpy."""
    factories.write_set(tmp_path, {"train": factories.single_rows(truth[:2])}, "single")
    (path,) = tmp_path.rglob("train*.parquet")
    table = pq.read_table(path).append_column("plate_z_m", pa.array([0.001, None], pa.float64()))
    made_by_us = pa.array([[0.0, 0.0, 0.0]] * 2, pa.list_(pa.float64()))
    pq.write_table(table.append_column("info.touched_object_pose.position", made_by_us), path)
    dataset = realtouch.load(tmp_path, "train")
    z_m = [each.row.contact_z_m() for each in dataset]
    expected = np.concatenate([z_m[0] - 0.001, z_m[1] - PRESS_DEPTH_M])
    np.testing.assert_array_equal(dataset.touches().heights_m(), expected)


ROUND, TOUCHES = 4, 8
PRESSED = [False, True, False, True, True, False, True, True]


def recordings(folder: Path) -> Path:
    """Write touches of a finger: their heights are no heights above a plate; some pictures show contact."""
    folder.mkdir()
    rng = np.random.default_rng(0)
    lines = ["file,round_id,touched,gel_x_m,gel_y_m,gel_z_m,gel_qx,gel_qy,gel_qz,gel_qw"]
    for number, is_pressed in enumerate(PRESSED):
        pixels = np.full((48, 64, 3), 90, np.uint8) + rng.integers(0, 3, (48, 64, 3), np.uint8)
        if is_pressed:
            top, left = 14 + 3 * (number % ROUND), 18 + 4 * (number % ROUND)
            pixels[top : top + 9, left : left + 9] += 60
        Image.fromarray(pixels).save(folder / f"{number}.png")
        lines.append(f"{number}.png,{number // ROUND},{is_pressed},0.1,0,{0.3 + 0.001 * number},0,0,0,1")
    (folder / "touches.csv").write_text("\n".join(lines))
    return folder


@pytest.mark.parametrize(
    ("mapped", "rule"),
    [
        ((), "the picture differs from the background"),
        (("pose=",), "the picture differs from the background"),
        (("in_contact=touched",), "the column 'extra.in_contact' is true"),
    ],
    ids=["poses", "pictures", "column"],
)
def test_contact_of_sets_of_others_is_not_that_of_the_published_sets(mapped, rule, tmp_path, capsys) -> None:
    columns = realtouch.ImportColumns().with_mapped(mapped)
    spec = realtouch.ImportSpec(columns=columns)
    realtouch.import_touches(recordings(tmp_path / "takes"), tmp_path / "set", spec)
    rounds = realtouch.load(tmp_path / "set")
    touches = rounds.touches()
    assert touches.in_contact().tolist() == PRESSED
    assert len(touches.with_contact()) == sum(PRESSED)
    assert (touches + touches).in_contact().tolist() == 2 * PRESSED
    is_stored = "column" in rule
    summary = realtouch.summarise(rounds)
    assert (summary.contact_rule or "").startswith(rule)
    assert summary.contact_share == (sum(PRESSED) / TOUCHES if is_stored else None)
    assert rule in (tmp_path / "set" / "README.md").read_text()
    items = [item for task in plan_gallery(str(tmp_path / "set")).tasks for item in task.make()]
    shown = [(item.values["in_contact"], item.values["contact"]) for item in items]
    assert shown == ([(2, "half or fewer"), (3, "more than half")] if is_stored else [(None, "unknown")] * 2)
    assert (draw_grid(rounds[0], 4) == CONTACT).all(axis=2).any() == is_stored
    realtouch.select(tmp_path / "set", tmp_path / "some", contact=True)
    assert "plate_z_m" not in realtouch.load(tmp_path / "some").column_names
    assert realtouch.load(tmp_path / "some").touch_counts.tolist() == [2, 3]
    with pytest.raises(InputError, match="heights do not decide"):
        touches.in_contact(recalibrate_z=False)
    with pytest.raises(InputError, match=r"min_height_m is nan; expected a number, finite"):
        touches.with_contact(float("nan"))
    if "pose=" not in mapped:  # a height that the user states counts above the deepest touch
        assert touches.with_contact(0.002).touch_indices.tolist() == [2, 3, 2, 3]
    with pytest.raises(InputError, match=r"'pos_in_cell'; next: import it again with --map position=COLUMN"):
        _ = touches[0].pos_in_cell_m
