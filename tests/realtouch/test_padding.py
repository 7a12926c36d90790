"""Clips of which no lengths are stated: padding is never taken for frames."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

import realtouch
from realtouch.columns.poses import clip_poses, contact_z_m, pose_sequences
from tactile_toolkit.errors import InputError
from tactile_toolkit.read.columns import RowGroup
from tactile_toolkit.read.dataset import Row
from tests.realtouch import factories
from tests.realtouch.factories import Layout, RoundTruth

UNSTATED = ("video_length_frames",)
LAYOUTS = {
    "padded": Layout(leave_out=UNSTATED),
    "padded by nulls": Layout(leave_out=UNSTATED, pad_null=True, fixed=False),
    "nested": Layout(leave_out=UNSTATED, nested=True),
    "ragged": Layout(leave_out=UNSTATED, padded=False),
}


def without_index(row: dict[str, Any], _: int) -> None:
    row["sensor_video"] = [
        {**clip, "bytes": clip["bytes"].replace(b"idx1", b"JUNK")} for clip in row["sensor_video"]
    ]


LAYOUTS["no index either"] = Layout(leave_out=UNSTATED, edit=without_index)


@pytest.mark.parametrize("layout", LAYOUTS.values(), ids=LAYOUTS)
def test_every_frame_counts_and_no_padding_does(
    layout: Layout, truth: list[RoundTruth], tmp_path: Path
) -> None:
    factories.write_set(tmp_path, {"train": factories.seq_rows(truth, layout)}, "seq", layout)
    dataset = realtouch.load(tmp_path)
    for record, expected in zip(dataset, truth, strict=True):
        lengths = [touch.frames for touch in expected.touches]
        assert [len(clip) for clip in record.sensor_video] == lengths
        assert [len(clip.timestamps_s) for clip in record.sensor_video] == lengths
        assert [len(stamps) for stamps in record.time_stamp_rel_seq] == lengths
        for made, poses, clip in zip(
            expected.touches, record.gel_pose_cell_frame_seq, record.sensor_video, strict=True
        ):
            np.testing.assert_array_equal(poses.position_m, made.position_m)
            np.testing.assert_array_equal(clip.poses.quaternion, made.quaternion)
            assert clip.contact_index("peak") == made.peak
            assert (clip.contact_window.start, clip.contact_window.stop - 1) == (
                made.contact_start,
                made.contact_end,
            )
        assert record.contact_frames().shape[0] == len(lengths)
    on_digit = [touch.on_digit for expected in truth for touch in expected.touches]
    touches = dataset.touches()
    np.testing.assert_allclose(touches.heights_m(), np.where(on_digit, 0.007, 0.0), atol=1e-9)
    assert len(touches.with_contact()) == sum(on_digit)
    assert realtouch.verify(str(tmp_path)).findings == ()


def test_padding_to_a_length_that_the_schema_states_is_no_frame_either(
    truth: list[RoundTruth], tmp_path: Path
) -> None:
    layout = LAYOUTS["padded"]
    factories.write_set(tmp_path, {"train": factories.seq_rows(truth[:1], layout)}, "seq", layout)
    (file,) = (tmp_path / "data").iterdir()
    table = pq.read_table(file)
    for place, field in enumerate(table.schema):
        if "_seq" in field.name:
            frames = len(table[place][0][0])
            values = field.type.value_type.value_type
            fixed = pa.list_(pa.list_(values, frames), field.type.list_size)
            table = table.set_column(place, field.name, table[place].cast(fixed))
    pq.write_table(table, file)
    lengths = [touch.frames for touch in truth[0].touches]
    assert min(lengths) < frames
    record = realtouch.load(tmp_path)[0]
    assert [len(stamps) for stamps in record.time_stamp_rel_seq] == lengths
    assert [len(poses.position_m) for poses in record.gel_pose_cell_frame_seq] == lengths


def test_the_missing_lengths_are_named_where_the_clips_are_not_there_either(
    seq_folder: Path,
) -> None:
    group = realtouch.load(seq_folder, "train")[0]._row.group
    row = Row(RowGroup(group.table.drop_columns(["video_length_frames", "sensor_video"])), 0)
    for ask in (pose_sequences, lambda row: clip_poses(row, 0), lambda row: contact_z_m(row, "seq")):
        with pytest.raises(InputError, match="no column 'video_length_frames'"):
            ask(row)
