"""Preview of an import: what it would make, without writing anything."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from os import PathLike, fspath

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc

from realtouch.importing import (
    arranging,
    extra_columns,
    formats,
    import_columns,
    import_sources,
    imported_rows,
)
from realtouch.touch_options import Alignment
from tactile_toolkit import store, wording
from tactile_toolkit.columns import units
from tactile_toolkit.json_types import JsonValue
from tactile_toolkit.touch import MEDIA_TYPE

_TOUCHES_SHOWN = 3
_VALUES_SHOWN = 8
_LONGEST_SHOWN = 60


@dataclass(frozen=True, slots=True)
class ImportPreview:
    """What an import would make.

    Attributes
    ----------
    layout, recognised_by : str
        Format, and the file by which it was recognised; empty if it was given.
    cut : str
        How recordings become touches; empty if the source has no recordings.
    touches, rounds : int
        Numbers of touches and rounds, without the touches that are known to be left out.
    splits : mapping of str to int
        Touches of each split.
    classes : sequence of str
        Names of the classes.
    pictures : str
        Size of the pictures, and how they are converted.
    columns : sequence of tuple of str
        Column of the source, what it becomes, and the unit in which it is read.
    first : sequence of mapping
        The first touches as they would be stored, without pictures.
    streams : sequence of tuple of str
        How streams of other rates fit the recordings, as rows of a table.
    left_out : sequence of tuple
        Reason, number of touches, and the message of the first.
    """

    layout: str
    recognised_by: str
    cut: str
    touches: int
    rounds: int
    splits: Mapping[str, int]
    classes: Sequence[str]
    pictures: str
    columns: Sequence[tuple[str, str, str]]
    first: Sequence[Mapping[str, str]]
    streams: Sequence[tuple[str, ...]]
    left_out: Sequence[tuple[str, int, str]]


def preview_import(
    source: str | PathLike[str],
    layout: str | None = None,
    columns: import_columns.ImportColumns | None = None,
    *,
    table: str | None = None,
    streams: Sequence[str] = (),
    alignment: Alignment | None = None,
    cut: str | None = None,
    classes: Sequence[str] = (),
    split: str | None = None,
) -> ImportPreview:
    """Read what :func:`import_touches` would import, with the same parameters, and write nothing.

    Returns
    -------
    ImportPreview

    Raises
    ------
    InputError
        As :func:`import_touches`.
    """
    reading = import_sources.Reading(layout, columns, table, tuple(streams), alignment, cut)
    found = import_sources.find_source(fspath(source), reading)
    touches = arranging.arranged(found, classes, split)
    usable = {
        name: sum(int(part.is_usable.sum()) for part in parts) for name, parts in touches.shards.items()
    }
    messages: dict[str, list[str]] = {}
    for _, name, error in found.touches.problems():
        messages.setdefault(error.reason, []).append(f"{name!r}: {error.message}")
    first = _first(touches, messages)
    return ImportPreview(
        found.layout,
        found.recognised_by,
        found.cut,
        sum(usable.values()),
        sum(len(part.where["round"].unique()) for parts in touches.shards.values() for part in parts),
        usable,
        touches.work.names,
        _pictures_in_words(found, touches),
        _uses(found, imported_rows.extras_in(touches.work.schema)),
        first,
        list(found.streams),
        [(reason, len(each), each[0]) for reason, each in messages.items()],
    )


def _first(touches: arranging.Arranged, messages: dict[str, list[str]]) -> list[dict[str, str]]:
    """Make the first touches as an import would, and note why others cannot be used."""
    parts = [part.take(np.flatnonzero(part.is_usable)) for each in touches.shards.values() for part in each]
    some = next((part for part in parts if len(part)), parts[0])[:_TOUCHES_SHOWN]
    content = touches.work(store.ShardName("preview", 0, 1), some)
    for each in content.skipped:
        messages.setdefault(each.reason, []).append(each.message)
    shown = []
    (media,) = [field.name for field in content.table.schema if field.type == pa.list_(MEDIA_TYPE)]
    counts = pc.list_value_length(content.table[media]).to_pylist()
    for row, count in zip(content.table.drop_columns([media]).to_pylist(), counts, strict=True):
        shown += [{name: _in_words(value, touch) for name, value in row.items()} for touch in range(count)]
    return shown


def _in_words(value: JsonValue, touch: int) -> str:
    if isinstance(value, list):
        value = value[touch]
    if isinstance(value, list) and len(value) > _VALUES_SHOWN:
        first = wording.printable(str(value[0]))[:_LONGEST_SHOWN]
        return f"{len(value)} entries, the first {first}"
    return wording.printable(str(value))[:_LONGEST_SHOWN]


def _pictures_in_words(found: import_sources.FoundSource, touches: arranging.Arranged) -> str:
    words = formats.IMPORTS[found.layout].describe(found.touches) or "stored as they are"
    size = touches.work.image_size
    return words if size is None else f"{size[1]} x {size[0]} pixels, {words}"


def _uses(found: import_sources.FoundSource, extras: Iterable[str]) -> list[tuple[str, str, str]]:
    """Return each column of the source, what it becomes, and its unit; ``extras`` are the extra columns."""
    columns = found.columns
    roles: dict[str | None, str] = {
        **{source: f"extra {name!r}" for source, name in extra_columns.kept_sources(columns, extras).items()},
        columns.label: "label",
        columns.round: "round",
        columns.object_id: "object_id",
        columns.split: "split",
        **dict.fromkeys(columns.position or (), "pos_in_cell"),
        **dict.fromkeys(columns.pose or (), "pose of the gel"),
        columns.image: "picture",
        columns.time: "time",
    }
    lengths = {*(columns.position or ()), *(columns.pose or ())[:3]}
    uses = []
    for name in found.touches.names:
        unit = units.stated_unit(name) or ""
        if name in lengths:
            unit = unit or columns.length_unit or "m"
        uses.append((wording.printable(name), roles.get(name, "left out"), unit))
    return [*uses, *((wording.printable(each), "left out", "") for each in found.left_out)]
