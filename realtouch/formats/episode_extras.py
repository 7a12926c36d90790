"""Further columns of touches as columns of frames; vectors in a column have one length."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc

from realtouch.touches import schema, stored_round
from tactile_toolkit import read

FEATURE = "observation."
"""Prefix of the names of these columns."""

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
    """A further column: its stored name, and its name and type as a column of frames."""

    stored: str
    name: str
    data_type: pa.DataType

    @property
    def is_per_frame(self) -> bool:
        """Whether it has an entry for each frame, not for each touch."""
        return self.stored.startswith(schema.EXTRA_PREFIX["frame"])

    def of_frames(self, row: stored_round.StoredRound, touch: int | None, count: int) -> pa.Array:
        """Return the values of an episode: of all touches of a round, or of the frames of one clip.

        A missing value is NaN or an empty text. Raises IntegrityError for fewer values than frames, and for
        vectors of another length.
        """
        values = row.extra_entries(self.stored)
        if touch is not None and self.is_per_frame:
            values = row.extra_of_frames(self.stored, values, touch, count)
        elif touch is not None:
            values = values.take(pa.array([touch] * count))
        with row.naming(self.stored, touch):
            return self._packed(values)

    def _packed(self, values: pa.Array) -> pa.Array:
        """Return numbers, texts or vectors of the type; ValueError for vectors of another length."""
        width, leaf = getattr(self.data_type, "list_size", 1), self.data_type
        if width > 1:
            leaf = leaf.value_type
        if read.list_depth(values.type)[0]:
            known = values.drop_null()
            found = pc.list_value_length(known).unique().sort().to_pylist()
            if found not in ([], [width]):
                lengths = " and of ".join(map(str, found))
                raise ValueError(f"vectors of {lengths} values; expected {width}, as in the first touch")
            places = np.full((len(values), width), -1)
            places[values.is_valid().to_numpy(zero_copy_only=False)] = np.arange(len(known) * width).reshape(
                -1, width
            )
            values = known.flatten().take(pa.array(places.ravel(), mask=places.ravel() < 0))
        try:
            flat = values.cast(leaf)
        except pa.ArrowInvalid as error:  # float64 does not hold them
            raise ValueError(
                "integers of 2**53 or more, some missing; expected all, or smaller ones"
            ) from error
        if flat.null_count:
            flat = flat.fill_null("" if pa.types.is_string(leaf) else np.nan)
        return pa.FixedSizeListArray.from_arrays(flat, width) if width > 1 else flat


def extra_columns_of(shards: Sequence[read.Shard]) -> tuple[ExtraColumn, ...]:
    """Return the further columns of a split, except those without any value.

    Their values are read to find the length of vectors, and whether values are missing.
    """
    types = read.column_types(shards[0].schema)
    names = {f"{FEATURE}{name}" for name in _TAKEN}
    found = []
    for name, stored in schema.extra_columns(types).items():
        entry, (width, has_gaps) = schema.extra_type(stored, types[stored]), _widths(shards, stored)
        depth, leaf = read.list_depth(entry)
        if has_gaps and not (pa.types.is_floating(leaf) or pa.types.is_string(leaf)):
            leaf = pa.float64()  # NaN stands for a missing value
        feature = f"{FEATURE}{name.replace('/', '_')}"
        while feature in names:
            feature = f"{feature}_"
        names.add(feature)
        if not depth:
            width = 1
        if width > 1:  # readers of LeRobotDatasets take vectors of length 1 for numbers
            leaf = pa.list_(leaf, width)
        if width:
            found.append(ExtraColumn(stored, feature, leaf))
    return tuple(found)


def _widths(shards: Iterable[read.Shard], stored: str) -> tuple[int, bool]:
    """Return the length of the first vector of a column, or 0, and whether values are missing."""
    width, has_gaps = 0, False
    for block in read.all_blocks(shards, [stored]):
        column = block.nested(stored)
        has_gaps = has_gaps or column.nulls > 0
        last = column.levels[-1]
        lengths = [last] if isinstance(last, int) else np.diff(last)
        width = width or int(next(filter(None, lengths), 0))
    return width, has_gaps
