"""Inputs that are refused before memory is allocated or filled with garbage."""

from __future__ import annotations

import io
import struct
from collections.abc import Callable
from pathlib import Path
from typing import Any

import av
import numpy as np
import pytest

import realtouch
from realtouch.video.avi import Avi, write_avi
from tactile_toolkit.errors import InputError, IntegrityError
from tactile_toolkit.touch import decode_image
from tests.jpegs import jpeg_of_scans
from tests.realtouch import factories
from tests.realtouch.factories import Layout

LARGE = factories.encode_jpeg(np.zeros((4096, 4096, 3), np.uint8), quality=10)


def one_clip(data: bytes, frames: int) -> Callable[[dict[str, Any], int], None]:
    """Replace touch 1 of the second row by a clip."""

    def edit(row: dict[str, Any], index: int) -> None:
        if index == 1:
            row["sensor_video"] = [dict(clip) for clip in row["sensor_video"]]
            row["sensor_video"][1]["bytes"] = data
            row["video_length_frames"] = [
                frames if touch == 1 else count for touch, count in enumerate(row["video_length_frames"])
            ]

    return edit


def repeated(frame: bytes, count: int) -> bytes:
    """Return an AVI of one frame, which its index lists many times."""
    whole = write_avi([frame], 4096, 4096, 25.0)
    start = whole.rindex(b"idx1")
    listed = whole[start + 8 : start + 24] * count
    changed = whole[:start] + b"idx1" + struct.pack("<I", len(listed)) + listed
    return changed[:4] + struct.pack("<I", len(changed) - 8) + changed[8:]


@pytest.mark.thorough
@pytest.mark.parametrize(
    ("data", "frames", "words"),
    [
        (repeated(LARGE, 2000), 2000, "an AVI whose index has frame 1 of 2000 outside of the stream"),
        (
            write_avi([LARGE] * 200, 4096, 4096, 25.0),
            200,
            "200 images of 4096 x 4096 pixels at once; the limit",
        ),
    ],
    ids=["repeated", "many"],
)
def test_a_clip_that_unpacks_to_gigabytes_is_refused(data, frames, words, seq_rows, tmp_path):
    layout = Layout(edit=one_clip(data, frames))
    factories.write_set(tmp_path, {"train": seq_rows[:2]}, "seq", layout)
    record = realtouch.load(tmp_path)[1]
    with pytest.raises(IntegrityError, match=f"row 1, touch 1, field 'sensor_video': {words}"):
        _ = record.sensor_video[1].frames()
    assert record.sensor_video[2].frames().shape[1:] == (72, 96, 3)


def test_images_that_unpack_to_gigabytes_are_refused(single_rows: list[dict], tmp_path: Path) -> None:
    def edit(row: dict[str, Any], _: int) -> None:
        row["sensor_image"] = [{"bytes": LARGE, "path": None}, *row["sensor_image"][1:] * 50]
        for name in ("pos_in_cell", "gel_pose_cell_frame.position", "gel_pose_cell_frame.quaternion"):
            row[name] = [row[name][0]] * len(row["sensor_image"])

    factories.write_set(tmp_path, {"train": single_rows[:1]}, "single", Layout(edit=edit, fixed=False))
    images = realtouch.load(tmp_path)[0].sensor_image
    with pytest.raises(IntegrityError, match="201 images of 4096 x 4096 pixels at once; the limit is"):
        images.batch()
    assert images[[1, 2]].shape == (2, 72, 96, 3)


@pytest.mark.parametrize("step", [1, 3])
def test_no_encoder_has_frames_overlap(step: int) -> None:
    """Equal frames, and gaps in time, which FFmpeg fills with frames without bytes."""
    stream = io.BytesIO()
    with av.open(stream, "w", format="avi") as output:
        video = output.add_stream("mjpeg", rate=25)
        video.height, video.width, video.pix_fmt = 32, 48, "yuvj420p"
        for index in range(20):
            frame = av.VideoFrame.from_ndarray(np.full((32, 48, 3), 90, np.uint8), format="rgb24")
            frame.pts = index * step
            output.mux(video.encode(frame))
        output.mux(video.encode(None))
    avi = Avi(memoryview(stream.getvalue()))
    assert len(avi) == 20
    assert (avi.starts[1:] >= avi.starts[:-1] + avi.sizes[:-1]).all()
    assert (avi.slots.tolist() == list(range(20))) == (step == 1)


@pytest.mark.parametrize("order", [(2, 0, 3, 1), (1, 0, 2, 3), (1, 2, 3, 0), (0, 1, 3, 2)])
def test_an_index_out_of_the_order_of_the_stream_is_named(order: tuple[int, ...]) -> None:
    """Frames would be played in another order than recorded."""
    jpegs = [factories.encode_jpeg(np.full((16, 24, 3), 40 * level, np.uint8)) for level in range(4)]
    whole = write_avi(jpegs, 24, 16, 25.0)
    start = whole.rindex(b"idx1") + 8
    entries = [whole[start + 16 * frame : start + 16 * frame + 16] for frame in order]
    data = memoryview(whole[:start] + b"".join(entries))
    with pytest.raises(
        ValueError, match=r"index has frame \d of 4 outside of the stream or over another frame"
    ):
        Avi(data)


def test_an_index_that_names_other_bytes_than_the_stream_is_named() -> None:
    whole = write_avi([factories.encode_jpeg(np.full((16, 24, 3), 40, np.uint8))] * 3, 24, 16, 25.0)
    start = whole.rindex(b"idx1") + 8 + 16 + 12
    shorter = int.from_bytes(whole[start : start + 4], "little") - 2
    data = memoryview(whole[:start] + shorter.to_bytes(4, "little") + whole[start + 4 :])
    with pytest.raises(ValueError, match="frame 1 of 3 where the stream has no frame of"):
        Avi(data).frame(1)


WRONG = {
    "float32": np.zeros((2, 72, 96, 3), np.float32),
    "int64": np.zeros((2, 72, 96, 3), np.int64),
    "strided": np.zeros((2, 72, 96, 6), np.uint8)[..., ::2],
    "backwards": np.zeros((2, 72, 96, 3), np.uint8)[..., ::-1],
    "too short": np.zeros((1, 72, 96, 3), np.uint8),
    "other size": np.zeros((2, 71, 96, 3), np.uint8),
    "flat": np.zeros(2 * 72 * 96 * 3, np.uint8),
    "read-only": np.frombuffer(bytes(2 * 72 * 96 * 3), np.uint8).reshape(2, 72, 96, 3),
    "no array": [0, 1],
}


@pytest.mark.parametrize("name", WRONG)
def test_an_out_that_does_not_fit_is_refused_before_it_is_written_to(name, single_folder, seq_folder):
    out: Any = WRONG[name]
    singles, clips = realtouch.load(single_folder, "train"), realtouch.load(seq_folder, "train")
    two = clips[0].with_touches([0, 1])
    for ask in (
        lambda: singles[0].sensor_image.batch([0, 1], out=out),
        lambda: singles.touches().images([0, 1], out=out),
        lambda: two.contact_frames(out=out),
        lambda: two.contact_frames("best", out=out),
    ):
        with pytest.raises(
            InputError, match=r"out is .*; expected a writable array of uint8 and shape \(2, 72"
        ):
            ask()
    assert not np.any(out[0])


def test_a_jpeg_of_hundreds_of_scans_is_not_decoded(single_rows: list[dict], tmp_path: Path) -> None:
    """A few bytes make a scan, and each scan decodes the picture again: 88 kB took 17 s."""
    assert decode_image(jpeg_of_scans(100)).shape == (8, 8, 3)

    def edit(row: dict[str, Any], index: int) -> None:
        if index == 1:
            row["sensor_image"] = [dict(blob) for blob in row["sensor_image"]]
            row["sensor_image"][2]["bytes"] = jpeg_of_scans(101)

    factories.write_set(tmp_path, {"train": single_rows[:2]}, "single", Layout(edit=edit))
    images = realtouch.load(tmp_path)[1].sensor_image
    for use in (lambda: images[2], images.batch, lambda: images.size(2)):
        with pytest.raises(IntegrityError, match=r"touch 2.*a JPEG of 101 scans; the limit is 100"):
            use()
    for quick in (True, False):
        findings = realtouch.verify(tmp_path, quick=quick).findings
        assert [(damage.row, damage.touch) for damage in findings] == [(1, 2)]
