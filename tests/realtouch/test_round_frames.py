from __future__ import annotations

import threading
from contextlib import suppress
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, strategies as st

import realtouch
from realtouch.touches.media import in_parallel
from realtouch.video.avi import Avi, write_avi
from tactile_toolkit.errors import IntegrityError
from tests.realtouch import factories
from tests.realtouch.factories import Layout

FRAMES = np.stack([np.full((16, 24, 3), 20 * index, np.uint8) for index in range(10)])
JPEGS = [factories.encode_jpeg(frame) for frame in FRAMES]
AVIS = {"FFmpeg": factories.encode_avi(FRAMES), "ours": write_avi(JPEGS, 24, 16, 25.0)}


@given(
    st.sampled_from(sorted(AVIS)),
    st.lists(st.tuples(st.floats(0, 1, exclude_max=True), st.integers(0, 255)), min_size=1, max_size=8),
    st.floats(0, 1),
)
def test_a_damaged_file_raises_or_gives_frames_of_its_stream(writer, changes, kept):
    """No bytes from outside of the file are used, and none twice."""
    data = bytearray(AVIS[writer])
    for place, value in changes:
        # Damage matters in headers and index; most of the file is pictures.
        data[int(place * 400) * (1 if value % 2 else -1)] = value
    for view in (memoryview(bytes(data)), memoryview(bytes(data[: int(kept * len(data))]))):
        with suppress(ValueError):
            avi = Avi(view)
            assert avi.starts[0] >= 0
            assert avi.starts[-1] + avi.sizes[-1] <= len(view)
            assert (avi.starts[1:] >= (avi.starts + avi.sizes)[:-1]).all()
            for frame in range(len(avi)):
                assert len(avi.frame(frame)) == avi.sizes[frame]


@pytest.mark.one_at_a_desk
@pytest.mark.parametrize(
    "layout",
    [
        Layout(),
        Layout(padded=False),
        Layout(seconds=True, fixed=False),
        Layout(pad_null=True, seconds=True),
        Layout(leave_out=("time_stamp_rel_seq",)),
    ],
    ids=["published", "ragged", "seconds", "null padding", "no stamps"],
)
def test_frames_of_a_round_are_those_of_its_clips(layout, truth, tmp_path):
    rows = factories.seq_rows(truth[:2], layout)
    factories.write_set(tmp_path, {"train": rows}, "seq", layout)
    record = realtouch.load(tmp_path)[1]
    clips = list(record.sensor_video)
    for method in ("contact_start", "contact_end", "peak", "best"):
        expected = np.stack([clip.contact_frame(method) for clip in clips])
        np.testing.assert_array_equal(record.contact_frames(method), expected)
        out = np.zeros_like(expected)
        assert record.contact_frames(method, threads=3, out=out) is out
        np.testing.assert_array_equal(out, expected)
    for threads in (1, 2):
        windows = record.contact_windows(threads=threads)
        for window, clip in zip(windows, clips, strict=True):
            np.testing.assert_array_equal(window, clip[clip.contact_window])


def test_windows_of_some_touches(seq_folder: Path) -> None:
    record = realtouch.load(seq_folder, "train")[0]
    every = record.contact_windows()
    for wanted in ([3, 0], slice(1, None, 2), np.array([False, True, False, False, True])):
        places = np.arange(5)[wanted]
        chosen = record.contact_windows(wanted)
        assert len(chosen) == len(places)
        for window, place in zip(chosen, places, strict=True):
            np.testing.assert_array_equal(window, every[place])
    assert record.contact_windows([]) == ()
    with pytest.raises(IndexError, match="out of bounds"):
        record.contact_windows([5])


def _broken(row: dict, place: int) -> None:
    blob = bytearray(row["sensor_video"][2]["bytes"])
    if place == 0:
        found = Avi(memoryview(bytes(blob)))
        row["sensor_video"][2]["bytes"] = bytes(blob[: int(found.starts[0])]) + bytes(
            len(blob) - int(found.starts[0])
        )
    elif place == 1:
        row["sensor_video"][2]["bytes"] = bytes(blob[: len(blob) // 2])
    elif place == 2:
        row["time_stamp_rel_seq"][2] = row["time_stamp_rel_seq"][2][::-1]
    elif place == 3:
        row["touch_end_time_rel"][2] = np.timedelta64(0, "us")
    else:
        row["sensor_video"][2]["bytes"] = b""


@pytest.mark.parametrize(
    ("place", "message"),
    [
        (0, r"touch 2, field 'sensor_video'"),
        (1, r"touch 2, field 'sensor_video': an AVI cut short"),
        (2, r"touch 2, field 'time_stamp_rel_seq': times that are missing or run backwards"),
        (3, r"touch 2, field 'touch_end_time_rel': contact from .* expected an end not before the start"),
        (4, r"touch 2, field 'sensor_video': no bytes are stored"),
    ],
)
def test_damage_is_named_with_its_touch(place, message, truth, tmp_path):
    rows = factories.seq_rows(truth[:1])
    factories.write_set(tmp_path, {"train": rows}, "seq", Layout(edit=lambda row, _: _broken(row, place)))
    record = realtouch.load(tmp_path)[0]
    for threads in (1, 2):
        for ask in (record.contact_frames, record.contact_windows):
            with pytest.raises(IntegrityError, match=rf"row 0, {message}"):
                ask(threads=threads)


@pytest.mark.parametrize("count", [0, 1, 1_000])
def test_every_task_is_done_once(count: int) -> None:
    done: list[int] = []
    in_parallel(done.append, count, 3)
    assert sorted(done) == list(range(count))


@pytest.mark.parametrize("wrong", [0, 57, 999])
def test_an_error_ends_the_work_of_all_threads(wrong: int) -> None:
    """In any thread; the others start no further work."""
    done: list[int] = []

    def work(piece: int) -> None:
        if piece == wrong:
            raise IndexError(piece)
        done.append(piece)

    before = threading.active_count()
    with pytest.raises(IndexError, match=str(wrong)):
        in_parallel(work, 1_000, 3)
    assert threading.active_count() == before
    assert wrong not in done
