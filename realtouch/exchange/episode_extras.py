"""Further columns of touches as columns of frames, whose vectors are of one length."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np
import pyarrow as pa

from realtouch import extras, schema, stored_round
from tactile_toolkit import read, wording
from tactile_toolkit.array_types import AnyArray

FEATURE = "observation."
"""How the names of these columns begin."""

# Columns and arrays of the formats themselves.
_TAKEN = (
    *(
        "images.tactile",
        "images.depth",
        "state",
        "action",
        "tactile",
        "label",
        "object_id",
        "gel_pose",
        "pos_in_cell",
    ),
    "in_contact",
    *("time_s", "timestamps", "right_wrist_pose", "camera_main_rgb", "sub_task_instruction"),
)


@dataclass(frozen=True, slots=True)
class ExtraColumn:
    """A further column: its stored name, its name among those of frames, and its type there."""

    stored: str
    name: str
    data_type: pa.DataType

    @property
    def is_per_frame(self) -> bool:
        """Whether it has an entry for each frame, not for each touch."""
        return self.stored.startswith(schema.EXTRA_PREFIX["frame"])

    def of_frames(self, row: stored_round.StoredRound, touch: int | None, count: int) -> pa.Array:
        """Return the values of an episode: of all touches of a round, or of the frames of one clip.

        What is missing is NaN, or an empty text. Raises IntegrityError for fewer values than frames, and for
        vectors of another length.
        """
        values = row.extra_entries(self.stored)
        if touch is not None and self.is_per_frame:
            frames = values[touch].values
            values = pa.nulls(count, values.type.value_type) if frames is None else frames.slice(0, count)
        elif touch is not None:
            values = values.take(pa.array([touch] * count))
        if len(values) < count:
            raise row.damaged(
                self.stored, f"{wording.with_count(len(values), 'frames')}; expected at least {count}", touch
            )
        with row.naming(self.stored, touch):
            return self._packed(extras.array_with_gaps(values))

    def _packed(self, values: AnyArray) -> pa.Array:
        """Return numbers, texts or vectors as Arrow stores them; ValueError for vectors of another length."""
        width, leaf = getattr(self.data_type, "list_size", 1), self.data_type
        if width > 1:
            leaf = leaf.value_type
        if 0 in values.shape[1:]:  # all of them are missing
            values = np.full((len(values), width), None)
        if values.ndim > 1 and values.shape[1] != width:
            raise ValueError(f"vectors of {values.shape[1]} values; expected {width}, as in the first touch")
        if pa.types.is_string(leaf):
            values = np.array([text or "" for text in values.reshape(-1)], object)
        if pa.types.is_floating(leaf):
            numbers = values.astype(leaf.to_pandas_dtype())
            if values.dtype == object and any(map(_is_rounded, values.reshape(-1), numbers.reshape(-1))):
                raise ValueError("integers of 2**53 or more, some missing; expected all, or smaller ones")
            values = numbers
        flat = pa.array(values.reshape(-1), leaf)
        return pa.FixedSizeListArray.from_arrays(flat, width) if width > 1 else flat


def _is_rounded(value: int | None, number: float) -> bool:
    return value is not None and int(number) != value


def extra_columns_of(shards: Sequence[read.Shard]) -> tuple[ExtraColumn, ...]:
    """Return the further columns of a split, except those without any value.

    Their values are read: for the length of vectors, and whether some are missing.
    """
    types = read.column_types(shards[0].schema)
    names = {f"{FEATURE}{name}" for name in _TAKEN}
    found = []
    for name, stored in schema.extra_columns(types).items():
        entry, (width, has_gaps) = schema.extra_type(stored, types[stored]), _widths(shards, stored)
        depth, leaf = read.list_depth(entry)
        if has_gaps and not (pa.types.is_floating(leaf) or pa.types.is_string(leaf)):
            leaf = pa.float64()  # where NaN stands for what is missing
        feature = f"{FEATURE}{name.replace('/', '_')}"
        while feature in names:
            feature = f"{feature}_"
        names.add(feature)
        width = width if depth else 1
        if width:
            # Readers of LeRobotDatasets take what is of length 1 for numbers.
            found.append(ExtraColumn(stored, feature, pa.list_(leaf, width) if width > 1 else leaf))
    return tuple(found)


def _widths(shards: Iterable[read.Shard], stored: str) -> tuple[int, bool]:
    """Return the length of the first vector of a column, 0 without any, and whether values are missing."""
    width, has_gaps = 0, False
    for block in read.all_blocks(shards, [stored]):
        column = block.nested(stored)
        has_gaps = has_gaps or column.nulls > 0
        last = column.levels[-1]
        lengths = [last] if isinstance(last, int) else np.diff(last)
        width = width or int(next(filter(None, lengths), 0))
    return width, has_gaps
