"""Sequences that are padded to one length: only frames within the stated length of a clip count."""

from __future__ import annotations

from pathlib import Path

import pyarrow as pa
import pyarrow.parquet as pq
import pytest

import realtouch
from realtouch.touches.stored_round import StoredRound
from tactile_toolkit.errors import InputError
from tactile_toolkit.read import RowGroup
from tests.realtouch import factories
from tests.realtouch.factories import Layout, RoundTruth


def test_padding_to_a_fixed_length_adds_no_frames(truth: list[RoundTruth], tmp_path: Path) -> None:
    layout = Layout()
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


def test_missing_lengths_are_named(seq_folder: Path) -> None:
    group = realtouch.load(seq_folder, "train")[0].row.group
    row = StoredRound(RowGroup(group.table.drop_columns(["video_length_frames"])), 0)
    for ask in (
        StoredRound.pose_sequences,
        lambda row: row.pose_sequences(0),
        lambda row: row.contact_z_m(),
        lambda row: realtouch.TouchClip(row, 0),
    ):
        with pytest.raises(InputError, match="no column 'video_length_frames'"):
            ask(row)
