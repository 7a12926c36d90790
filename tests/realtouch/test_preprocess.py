"""Backgrounds, differences and contact by picture, compared with plain NumPy and known touches."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, strategies as st
from hypothesis.extra import numpy as arrays
from PIL import Image

import realtouch
from realtouch.contact import median_of
from realtouch.touches import image_contacts
from tactile_toolkit.errors import InputError
from tests.realtouch import factories

PICTURES = arrays.arrays(np.uint8, st.tuples(st.integers(1, 9), st.just(3), st.just(4), st.just(3)))


@given(PICTURES)
def test_the_background_is_the_median(pictures):
    assert (realtouch.background(pictures) == np.floor(np.median(pictures, axis=0))).all()


@pytest.mark.parametrize("count", [255, 256, 1000])
def test_the_background_of_many_pictures(count: int):
    pictures = np.random.default_rng(count).integers(0, 256, (count, 15, 20, 3)).astype(np.uint8)
    assert (realtouch.background(pictures) == np.floor(np.median(pictures, axis=0))).all()
    assert (median_of(lambda: [pictures[:99], pictures[99:]]) == realtouch.background(pictures)).all()


@pytest.mark.thorough
def test_the_background_of_pictures_read_a_few_at_a_time(single_folder: Path, seq_folder: Path, monkeypatch):
    rounds = realtouch.load(single_folder, split="train")
    clips = realtouch.load(seq_folder, split="train")
    images = np.concatenate([each.sensor_image.batch() for each in rounds])
    frames = np.concatenate([clip.frames() for each in clips for clip in each.sensor_video])
    monkeypatch.setattr(image_contacts, "_BATCH_BYTES", 2 * images[0].nbytes)
    for source, expected in (
        (rounds, images),
        (rounds.touches(), images),
        (rounds.touches()[3:9], images[3:9]),
        (rounds[1], rounds[1].sensor_image.batch()),
        (clips, frames),
        (clips.touches()[::4], np.concatenate([touch.clip.frames() for touch in clips.touches()[::4]])),
        (clips[0].sensor_video[1], clips[0].sensor_video[1].frames()),
    ):
        assert (realtouch.background(source) == np.floor(np.median(expected, axis=0))).all()


@given(st.data())
def test_differences(data):
    pictures = data.draw(PICTURES)
    base = data.draw(arrays.arrays(np.uint8, pictures.shape[1:]))
    exact = pictures.astype(int) - base
    assert (realtouch.difference(pictures, base) == exact).all()
    assert (realtouch.difference(pictures, base, "absolute") == abs(exact)).all()
    grey = realtouch.difference(pictures, base, "grey").astype(int)
    assert (grey == np.floor(128 + exact / 2)).all()
    assert (realtouch.difference(pictures[0], base) == exact[0]).all()


@given(st.data())
def test_scores_are_those_of_plain_numpy(data):
    pictures = data.draw(PICTURES)
    base = data.draw(arrays.arrays(np.uint8, pictures.shape[1:]))
    least, crop = data.draw(st.integers(0, 60)), data.draw(st.sampled_from([0.3, 0.5, 1.0]))
    rule = realtouch.ContactThresholds(least, 2, 1.0, crop)
    score = realtouch.contact_score(pictures, base, rule)
    for number, picture in enumerate(pictures):
        change = np.abs(picture.astype(int) - base).astype(np.uint8)
        # Pillow rounds the same weights to 16 bits instead of 14: a level apart at most.
        grey = np.array(Image.fromarray(change).convert("L"), int)
        rows, columns = rule.window(3, 4)
        inside = grey[rows, columns]
        assert (inside > least + 1).sum() <= score.area_px[number] <= (inside >= least).sum()
        if score.area_px[number]:
            assert least < score.intensity[number] <= inside.max() + 1
        assert rule.holds(realtouch.contact_score(picture, base, rule)) == rule.holds(score)[number]


def test_the_best_frame_lies_in_the_contact_and_is_the_deepest(seq_folder: Path, truth):
    rule = realtouch.ContactThresholds(min_area_px=4, crop=1.0)
    for record, made in zip(realtouch.load(seq_folder, split="train"), truth, strict=True):
        for clip, touch in zip(record.sensor_video, made.touches, strict=True):
            frame, score = realtouch.best_frame(clip, rule)
            assert abs(frame - touch.peak) <= 1
            assert rule.holds(score)
            base = realtouch.background(clip)
            again, same = realtouch.best_frame(clip.frames(), rule, base=base)
            assert (again, same.area_px, same.intensity) == (frame, score.area_px, score.intensity)


def test_contacts_of_clips_and_of_images(seq_folder: Path, single_folder: Path):
    rule = realtouch.ContactThresholds(min_area_px=4, crop=1.0)
    touches = realtouch.load(seq_folder, split="train").touches()
    found = realtouch.contacts_by_image(touches, rule, threads=3)
    assert len(found) == len(touches)
    assert found.contact.all()
    for index in (0, 7):
        frame, score = realtouch.best_frame(touches[index].clip, rule)
        assert (found.frame[index], found.area_px[index], found.intensity[index]) == (
            frame,
            score.area_px,
            score.intensity,
        )
        assert (found.picture(index) == touches[index].clip[frame]).all()
    backwards = realtouch.contacts_by_image(touches[::-1], rule)
    assert (backwards.area_px[::-1] == found.area_px).all()

    images = realtouch.load(single_folder, split="train").touches()
    found = realtouch.contacts_by_image(images, rule)
    base = realtouch.background(images[:5])
    score = realtouch.contact_score(images.images(slice(5)), base, rule)
    assert (found.area_px[:5] == score.area_px).all()
    assert (found.picture(6) == images[6].image).all()
    assert not found.frame.any()


def test_the_selection_of_a_known_consumer_by_plain_numpy(tmp_path: Path):
    """Median of the clip, middle half, grey above 10, 40 pixels, mean 12; clips of one frame too."""
    rounds = [factories.make_round(number, 5, (96, 72), (20, 30), noise=4.0) for number in range(3)]
    still = [replace(each, contact_start=0, contact_end=0, peak=0) for each in rounds[1].touches]
    still = [
        replace(
            each,
            frames=1,
            pixels=each.pixels[:1],
            position_m=each.position_m[:1],
            quaternion=each.quaternion[:1],
        )
        for each in still
    ]
    rounds[1] = replace(rounds[1], touches=still)
    factories.write_set(tmp_path / "clips", {"train": factories.seq_rows(rounds)}, "seq")
    touches = realtouch.load(tmp_path / "clips", split="train").touches()
    found = realtouch.contacts_by_image(touches, threads=2)
    for index, touch in enumerate(touches):
        frames = np.asarray(touch.clip.frames()).astype(int)
        change = np.abs(frames - np.floor(np.median(frames, axis=0)).astype(int))[:, 18:54, 24:72]
        grey = (change @ [4899, 9617, 1868] + 8192) >> 14
        changed = np.where(grey > 10, grey, 0)
        best = int(changed.sum(axis=(1, 2)).argmax())
        area = int((changed[best] > 0).sum())
        intensity = changed[best].sum() / max(area, 1)
        assert (found.frame[index], found.area_px[index]) == (best, area)
        assert found.intensity[index] == pytest.approx(intensity, rel=1e-12)
        assert found.contact[index] == (area >= 40 and intensity >= 12)
    assert found.contact.tolist() == [True] * 5 + [False] * 5 + [True] * 5
    assert len(found.select(0.25)) == 10 + 3
    assert (found.select(0.0).touches.round_positions == [0] * 5 + [2] * 5).all()


@pytest.mark.parametrize("share", [0.0, 0.2, 0.5, 0.99])
def test_a_share_of_touches_without_contact(single_folder: Path, share: float):
    touches = realtouch.load(single_folder, split="train").touches()
    mask = np.arange(len(touches)) % 3 == 0
    chosen = touches.sample(no_contact_fraction=share, seed=3, contact=mask)
    kept = set(chosen.dataset.column("id")[chosen.round_positions] + chosen.touch_indices.astype(str))
    image_contacts = set(
        touches.dataset.column("id")[touches.round_positions[mask]] + touches.touch_indices[mask].astype(str)
    )
    assert image_contacts <= kept
    expected = min((~mask).sum(), round(mask.sum() * share / (1 - share)))
    assert len(kept) == len(chosen) == mask.sum() + expected
    # In any order, and with several seeds.
    turned = touches[::-1].sample(no_contact_fraction=share, seed=3, contact=mask[::-1])
    assert list(turned) == list(chosen)[::-1]
    if 0 < expected < (~mask).sum():
        assert any(
            list(touches.sample(no_contact_fraction=share, seed=s, contact=mask)) != list(chosen)
            for s in range(9)
        )
    found = realtouch.ImageContacts(touches, *np.zeros((3, len(touches)), int), mask).select(share, 3)
    assert list(found.touches) == list(chosen)
    assert found.contact.sum() == mask.sum()


def test_clips_of_several_sizes_have_no_background(seq_folder: Path, tmp_path: Path):
    realtouch.resize(seq_folder, tmp_path / "small", width=48, height=36, split="train")
    both = realtouch.load(seq_folder, split="train") + realtouch.load(tmp_path / "small", split="train")
    with pytest.raises(InputError, match="96 x 72 and of 48 x 36 pixels have no common background"):
        realtouch.background(both)
    assert len(realtouch.contacts_by_image(both.touches()[10:20])) == 10


def test_invalid_touches_are_named(single_folder: Path):
    touches = realtouch.load(single_folder, split="train").touches()
    pictures = np.zeros((2, 4, 4, 3), np.uint8)
    for ask, words in (
        (lambda: realtouch.background(touches[:0]), "no pictures"),
        (lambda: realtouch.background(pictures[:0]), "no pictures"),
        (lambda: realtouch.background(pictures.astype(float)), "float64; expected .*uint8"),
        (lambda: realtouch.difference(pictures, pictures[0, :3]), r"shape \(3, 4, 3\); expected \(4, 4, 3\)"),
        (lambda: realtouch.difference(pictures, pictures[0], "colour"), "no difference 'colour'"),
        (lambda: realtouch.contact_score(pictures, pictures[0, :3]), r"expected \(4, 4, 3\)"),
        (lambda: realtouch.best_frame(pictures[:0]), "no frame"),
        (lambda: realtouch.contacts_by_image(touches.dataset), "expected touches, such as"),
        (lambda: realtouch.ContactThresholds(crop=0), "crop of the contact thresholds is 0"),
        (
            lambda: realtouch.ContactThresholds(min_change=float("nan")),
            "min_change of the contact thresholds is nan",
        ),
        (lambda: touches.sample(no_contact_fraction=1), "no_contact_fraction is 1; expected 0 to below 1"),
        (lambda: touches.sample(no_contact_fraction=0.1, seed=-1), "the seed is -1"),
        (lambda: touches.sample(no_contact_fraction=0.1, contact=np.zeros(3, bool)), r"bool of shape \(3,\)"),
    ):
        with pytest.raises(InputError, match=words):
            ask()
