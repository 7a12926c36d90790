"""The height of the plate is kept when the touches that show it are removed."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

import realtouch
from realtouch.contact import contact_heights_m
from realtouch.touch_gallery import plan_gallery
from realtouch.touch_previews import CONTACT, draw_grid
from tactile_toolkit.touch import PRESS_DEPTH_M
from tests.realtouch import factories
from tests.realtouch.factories import RoundTruth


@pytest.fixture(params=["seq", "single"])
def source(request: pytest.FixtureRequest, seq_folder: Path, single_folder: Path) -> Path:
    return seq_folder if request.param == "seq" else single_folder


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
    z_m = [each.row.contact_z_m("single") for each in dataset]
    expected = np.concatenate([z_m[0] - 0.001, z_m[1] - PRESS_DEPTH_M])
    np.testing.assert_array_equal(dataset.touches().heights_m(), expected)
