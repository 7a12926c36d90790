"""Choosing rounds and touches of a data set by label, object and contact."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from realtouch.columns.poses import contact_z_m, touch_total
from realtouch.contact import MIN_CONTACT_HEIGHT_M
from realtouch.convert.plan import RowChoice, Source
from tactile_toolkit.read.dataset import Row
from tactile_toolkit.touch.rows import flat_table, is_per_touch, take_touches
from tactile_toolkit.touch.schema import MEDIA_COLUMN, PLATE_COLUMN, Kind, column_type

__all__ = ["KeepTouches", "Selection", "choose_rows"]


@dataclass(frozen=True)
class Selection:
    """What to keep.

    Attributes
    ----------
    contact : bool
        Only touches in which the gel stopped on an object.
    min_height_m : float
        Height above the plate from which a touch counts as contact, metres.
    recalibrate_z : bool
        Take the deepest touch of each round as the plate.
    labels : tuple of str
        Classes, by name or number; all when empty.
    objects : tuple of int
        Objects; all when empty.
    limit : int or None
        Only the first so many rounds of each split, of those that are left in the end.
    """

    contact: bool = False
    min_height_m: float = MIN_CONTACT_HEIGHT_M
    recalibrate_z: bool = True
    labels: tuple[str, ...] = ()
    objects: tuple[int, ...] = ()
    limit: int | None = None


@dataclass(frozen=True)
class KeepTouches:
    """Step of ``select``.

    Attributes
    ----------
    some_touches : bool
        Whether rounds lose touches, so that they differ in length.
    """

    some_touches: bool

    def schema(self, source: Any) -> Any:
        """Return the schema of the source; where rounds differ, lists over touches have no fixed length.

        Rounds that lose touches keep the height of their plate: the touches that showed it may be gone.
        """
        import pyarrow as pa

        if not self.some_touches:
            return source
        fields = [
            pa.field(field.name, pa.list_(field.type.value_type))
            if is_per_touch(field.name, field.type)
            else field
            for field in source
        ]
        if column_type(source, PLATE_COLUMN) is None:
            fields.append(pa.field(PLATE_COLUMN, pa.float64()))
        return pa.schema(fields)

    def apply(self, row: Row, choice: RowChoice, split: str) -> Any:
        """Pass a row on, with the touches chosen; no image or clip is decoded."""
        import pyarrow as pa

        flat = flat_table(row.group.table.slice(row.index, 1))
        if choice.touches is None:
            return flat
        kept = take_touches(flat, choice.touches, touch_total(row))
        if row.has(PLATE_COLUMN):
            return kept
        kind: Kind = "single" if row.has(MEDIA_COLUMN["single"]) else "seq"
        plate_m = contact_z_m(row, kind).min(initial=np.inf)
        return kept.append_column(PLATE_COLUMN, pa.array([plate_m], pa.float64()))


def choose_rows(source: Source, selection: Selection) -> dict[str, list[RowChoice]]:
    """Decide which rows and touches of each split to keep; reads small columns only.

    Raises
    ------
    InputError
        A class that does not exist.
    """
    return {split: _choose_split(source, split, selection) for split in source.shards}


def _choose_split(source: Source, split: str, selection: Selection) -> list[RowChoice]:
    from realtouch.dataset import dataset_of

    dataset = dataset_of(source.shards[split], source.kind)
    if selection.labels:
        dataset = dataset.filter_labels([_label(name, dataset.label_names) for name in selection.labels])
    if selection.objects:
        dataset = dataset[np.isin(dataset.column("object_id"), selection.objects)]
    rows = dataset.row_numbers.tolist()
    if not selection.contact:
        return [RowChoice(row) for row in rows[: selection.limit]]
    touches = dataset.touches().with_contact(selection.min_height_m, selection.recalibrate_z)
    kept: list[list[int]] = [[] for _ in rows]
    for position, touch in zip(touches.round_positions.tolist(), touches.touch_indices.tolist(), strict=True):
        kept[position].append(touch)
    choices = [RowChoice(row, tuple(chosen)) for row, chosen in zip(rows, kept, strict=True) if chosen]
    return choices[: selection.limit]


def _label(name: str, known: Sequence[str]) -> int | str:
    return name if name in known or not name.isdecimal() else int(name)
