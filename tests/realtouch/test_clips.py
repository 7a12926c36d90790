from __future__ import annotations

import io
from pathlib import Path

import av
import numpy as np
import pytest
from hypothesis import given, strategies as st

import realtouch
from realtouch.contact import CLOCK_TOLERANCE_S, contact_heights_m, contact_window
from realtouch.touches.media import TouchClip
from realtouch.video.avi import MAX_CLIP_FRAMES, Avi, write_avi
from tactile_toolkit.touch import encode_image
from tests.realtouch import factories
from tests.realtouch.factories import RoundTruth

FRAMES = np.stack([np.full((16, 24, 3), 20 * index, np.uint8) for index in range(10)])
AVI = factories.encode_avi(FRAMES)


@pytest.fixture(scope="module")
def clip(seq_folder: Path) -> TouchClip:
    return realtouch.load(seq_folder, "train")[0].sensor_video[0]


def test_frames_equal_the_encoded_ones(clip: TouchClip, truth: list[RoundTruth]) -> None:
    made = truth[0].touches[0]
    assert (len(clip), clip.size, clip.fps) == (made.frames, (72, 96), 25.0)
    frames = clip.frames()
    assert frames.shape == made.pixels.shape
    assert np.abs(frames.astype(int) - made.pixels).mean() < 3
    np.testing.assert_array_equal(clip[5], frames[5])
    np.testing.assert_array_equal(clip[-1], frames[-1])
    for index in (slice(3, 9), slice(None, None, 7), [4, 1], np.arange(made.frames) == 6):
        np.testing.assert_array_equal(clip[index], frames[index])
    np.testing.assert_array_equal(clip.frames(threads=2), frames)
    with pytest.raises(IndexError, match="out of range"):
        clip[made.frames]


def decode_with_ffmpeg(data: memoryview) -> np.ndarray:
    with av.open(io.BytesIO(data)) as container:
        return np.stack([frame.to_ndarray(format="rgb24") for frame in container.decode(video=0)])


def test_contact_frames_are_the_true_ones(seq_folder: Path, truth: list[RoundTruth]) -> None:
    for record, expected in zip(realtouch.load(seq_folder, "train"), truth, strict=True):
        for clip, made in zip(record.sensor_video, expected.touches, strict=True):
            assert clip.contact_index("contact_start") == made.contact_start
            assert clip.contact_index("contact_end") == made.contact_end
            assert clip.contact_index("peak") == made.peak
            # The deepest press changes the image most; its neighbour may look the same after JPEG.
            assert abs(clip.contact_index("best") - made.peak) <= 1
            np.testing.assert_array_equal(clip.contact_frame("peak"), clip[made.peak])
            assert clip[clip.contact_window].shape[0] == made.contact_end - made.contact_start + 1


@given(st.lists(st.floats(0, 10), min_size=1, max_size=30), st.floats(-1, 11), st.floats(0, 5))
def test_a_window_holds_a_frame_and_only_frames_of_contact(times, start, span):
    stamps = np.sort(times)
    window = contact_window(stamps, start, start + span)
    first, last = start - CLOCK_TOLERANCE_S, start + span + CLOCK_TOLERANCE_S
    inside = np.flatnonzero((stamps >= first) & (stamps <= last))
    assert 0 <= window.start < window.stop <= len(stamps)
    if len(inside):
        assert (window.start, window.stop - 1) == (inside[0], inside[-1])
    else:
        assert window.stop - window.start == 1
        assert window.start == int(np.argmin(np.abs(stamps - (start + span))))


@given(st.integers(0, 1800 * 25), st.integers(0, 60), st.integers(0, 30))
def test_a_clock_in_single_precision_has_the_same_windows(offset: int, start: int, count: int) -> None:
    """At most half an hour; frames are 400 times as far apart as times that count as equal."""
    exact = (offset + np.arange(91)) / 25
    rounded = exact.astype(np.float32).astype(np.float64)
    expected = slice(start, start + count + 1)
    for stamps in (exact, rounded):
        for clock in (exact, rounded):
            assert contact_window(stamps, clock[start], clock[start + count]) == expected


def test_a_clip_is_an_array_for_numpy(clip: TouchClip) -> None:
    frames = clip.frames()
    np.testing.assert_array_equal(np.asarray(clip), frames)
    assert np.array(clip, np.float32).dtype == np.float32
    assert np.median(clip, axis=0).shape == (72, 96, 3)
    with pytest.raises(ValueError, match="without a copy"):
        np.asarray(clip, copy=False)


def test_ties_go_to_the_earlier_frame() -> None:
    frames = np.zeros((9, 8, 8, 3), np.uint8)
    frames[3] = frames[6] = 200
    assert realtouch.best_frame(frames)[0] == 3
    frames[6, 4, 4] = 210
    assert realtouch.best_frame(frames)[0] == 6


@given(st.lists(st.floats(-0.01, 0.02), min_size=1, max_size=20), st.floats(-0.003, 0.003))
def test_recalibrated_contact_does_not_depend_on_the_drift(heights: list[float], drift: float) -> None:
    z_m = np.round(np.asarray(heights), 4)
    clear = np.abs(z_m - z_m.min() - 0.006) > 1e-6
    met, drifted = (contact_heights_m(each) >= 0.006 for each in (z_m, z_m + drift))
    np.testing.assert_array_equal(met[clear], drifted[clear])
    assert contact_heights_m(z_m).min() == 0
    np.testing.assert_array_equal(contact_heights_m(z_m, recalibrate_z=False), z_m)


def test_heights_and_contact_of_touches(seq_folder, single_folder, truth):
    on_digit = [touch.on_digit for expected in truth for touch in expected.touches]
    drift = np.repeat([expected.z_drift_m for expected in truth], 5)
    for folder in (seq_folder, single_folder):
        touches = realtouch.load(folder, "train").touches()
        np.testing.assert_allclose(touches.heights_m(), np.where(on_digit, 0.007, 0.0), atol=1e-9)
        np.testing.assert_allclose(
            touches.heights_m(False), np.where(on_digit, 0.007, 0.0) + drift, atol=1e-9
        )
        kept = touches.with_contact()
        assert [(t.round_id, t.touch_index) for t in kept] == [
            (t.round_id, t.touch_index) for t, wanted in zip(touches, on_digit, strict=True) if wanted
        ]
        # The plate is found among all touches of a round, also after a selection.
        assert len(touches[np.array(on_digit)].with_contact()) == sum(on_digit)
        assert len(touches.with_contact(min_height_m=0.008)) == 0


def test_an_avi_of_ours_reads_back_and_in_ffmpeg() -> None:
    jpegs = [encode_image(frame) for frame in FRAMES]
    data = write_avi(jpegs, 24, 16, 25.0)
    assert data == write_avi(jpegs, 24, 16, 25.0)
    avi = Avi(memoryview(data))
    assert [bytes(avi.frame(frame)) for frame in range(10)] == jpegs
    pixels = decode_with_ffmpeg(memoryview(data))
    assert pixels.shape == (10, 16, 24, 3)
    assert np.abs(pixels.astype(int) - FRAMES).max() <= 6
    short = bytearray(data)  # the shortest header of a stream, and the former rest of it
    at = short.index(b"strh") + 4
    short[at : at + 4], short[at + 32 : at + 40] = b"\x1c\0\0\0", b"JUNK\x14\0\0\0"
    assert Avi(memoryview(short)).fps == avi.fps == 25


def test_repeated_frames_take_a_slot_without_bytes() -> None:
    jpegs = [encode_image(frame) for frame in FRAMES[:4]]
    avi = Avi(memoryview(write_avi([jpegs[0], b"", jpegs[1], jpegs[2]], 24, 16, 25.0)))
    assert len(avi) == 3
    assert avi.slots.tolist() == [0, 2, 3]


@pytest.mark.parametrize("keep", [0, 5, 20, 300, len(AVI) // 2, len(AVI) - 1])
def test_a_cut_avi_is_refused(keep: int) -> None:
    with pytest.raises(ValueError, match=r"cut short|expected an AVI"):
        Avi(memoryview(AVI[:keep]))


def test_hostile_counts_are_refused() -> None:
    with pytest.raises(ValueError, match="the limit is"):
        Avi(memoryview(write_avi([b"x"] * (MAX_CLIP_FRAMES + 1), 24, 16, 25.0)))
