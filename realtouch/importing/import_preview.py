"""Preview an import: read what it would make, and write nothing."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import chain
from os import PathLike, fspath

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc

from realtouch.importing import import_options, import_plan, import_sources, source_touches, stored_columns
from tactile_toolkit import store, wording
from tactile_toolkit.columns import units
from tactile_toolkit.touch import MEDIA_TYPE
from tactile_toolkit.value_types import JsonValue

_TOUCHES_SHOWN = 3
_VALUES_SHOWN = 8
_LONGEST_SHOWN = 60
_PREVIEW_BYTES = 64 << 20  # of pictures that are read


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
        Numbers of touches and rounds, without the touches that would be left out. Pictures are read up to a
        limit, which ``notes`` states.
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
    notes : sequence of str
        Decisions of the import, such as which folders are the classes.
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
    notes: Sequence[str]


def preview_import(
    source: str | PathLike[str],
    spec: import_options.ImportSpec | None = None,
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
    spec = spec or import_options.ImportSpec()
    recordings = import_sources.find_source(fspath(source), spec)
    touches = import_plan.arranged(recordings, spec)
    parts, read = _checked(touches)
    every = [part for of_split in parts.values() for part in of_split]
    usable = {split: sum(int(part.is_usable.sum()) for part in of_split) for split, of_split in parts.items()}
    rounds = sum(len(part.listing.filter(pa.array(part.is_usable))["round"].unique()) for part in every)
    messages: dict[str, list[str]] = {}
    for _, name, error in chain.from_iterable(part.problems() for part in every):
        messages.setdefault(error.reason, []).append(f"{name!r}: {error.message}")
    notes = [*recordings.notes, *touches.notes]
    too_many = import_plan.too_many_left_out(touches, spec.max_left_out)
    if too_many is not None:
        notes.append(f"the import would stop: {too_many}")
    elif not rounds:
        notes.append("the import would be refused, as every touch would be left out")
    pictures = recordings.conversion or "stored as they are"
    size = touches.make_shard.image_size
    if size is not None:
        pictures = f"{size[1]} x {size[0]} pixels, {pictures}"
    total = sum(map(len, every))
    if read < total:
        notes.append(f"the pictures of {read:,} of {wording.with_count(total, 'touches')} were read")
    return ImportPreview(
        recordings.layout,
        recordings.recognised_by,
        recordings.cut,
        sum(usable.values()),
        rounds,
        usable,
        touches.names,
        pictures,
        _uses(recordings, touches.extras),
        _first(touches, every),
        list(recordings.streams),
        [(reason, len(texts), texts[0]) for reason, texts in messages.items()],
        notes,
    )


def _checked(touches: import_plan.Arranged) -> tuple[dict[str, list[source_touches.SourceTouches]], int]:
    """Read pictures up to a limit; return the touches of each split with problems, and how many were read."""
    parts: dict[str, list[source_touches.SourceTouches]] = {}
    read = 0
    left_bytes = _PREVIEW_BYTES
    for split, of_split in touches.shards.items():
        parts[split] = []
        for part in of_split:
            ends = np.cumsum(part.listing["size"].to_numpy())
            count = int(np.searchsorted(ends, left_bytes, side="right"))
            left_bytes -= int(ends[count - 1]) if count else 0
            read += count
            parts[split].append(part.with_problems(touches.make_shard.problems_of_pictures(part[:count])))
    return parts, read


def _first(
    touches: import_plan.Arranged, parts: Sequence[source_touches.SourceTouches]
) -> list[dict[str, str]]:
    """Make the first touches as an import would."""
    usable = (part.take(np.flatnonzero(part.is_usable)) for part in parts)
    some = next((part for part in usable if len(part)), parts[0])[:_TOUCHES_SHOWN]
    content = touches.make_shard(store.ShardName("preview", 0, 1), some)
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


def _uses(
    recordings: import_sources.ReadSource, extras: stored_columns.ExtraColumns
) -> list[tuple[str, str, str]]:
    """Return each column of the source, what it becomes, and its unit; ``extras`` are the extra columns."""
    columns = recordings.columns
    roles: dict[str | None, str] = {
        **{source: f"extra {name!r}" for source, name in extras.names.items()},
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
    for name in recordings.touches.names:
        unit = units.Quantity.stated_unit(name) or ""
        if name in lengths:
            unit = unit or columns.length_unit or "m"
        uses.append((wording.printable(name), roles.get(name, "left out"), unit))
    return [*uses, *((wording.printable(field_name), "left out", "") for field_name in recordings.left_out)]
