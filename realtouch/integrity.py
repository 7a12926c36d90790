"""Damage of files and rounds: found, listed, left out."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager, suppress
from functools import partial
from typing import Any

import numpy as np
import pyarrow as pa

from realtouch.columns import Damage, DamagedRoundError, TouchRow, rows_of
from realtouch.media import SensorImages, TouchClip
from realtouch.schema import PER_TOUCH_COLUMNS, POSE_COLUMN, media_kind, require_types
from tactile_toolkit import catalog, read, run
from tactile_toolkit.array_types import Int64
from tactile_toolkit.errors import InputError, IntegrityError, ToolkitError
from tactile_toolkit.touch import CLASS_NAMES, MEDIA_COLUMN, Kind, decode_image, image_size

_NAMES_SHOWN = 12


def agreeing_files(
    shards: Iterable[read.Shard], where: str, left_out: list[Damage] | None = None
) -> list[read.Shard]:
    """Return the files of a data set that can be read and hold what the first of them holds.

    Of the others it is noted in ``left_out`` what is wrong; without such a list it is raised: InputError for
    a file that is not one of touches, IntegrityError for one that is damaged or holds something else.
    """
    files: list[read.Shard] = []
    for shard in shards:
        try:
            kind = media_kind(shard.schema, shard.path if files else where)
            require_types(shard)
            if files:
                _require_agreement(shard, kind, files)
            files.append(shard)
        except (InputError, IntegrityError) as error:
            if left_out is None or (isinstance(error, InputError) and not files):
                raise
            left_out.append(unreadable_file(shard.path, error))
    return files


def _require_agreement(shard: read.Shard, kind: Kind, files: Sequence[read.Shard]) -> None:
    """Refuse a file of another kind, or with other classes, than those before it; IntegrityError."""
    first = media_kind(files[0].schema, files[0].path)
    if kind != first:
        raise IntegrityError(
            f"{shard.path!r}, field {MEDIA_COLUMN[first]!r}: the column is not there; expected it as in "
            f"{files[0].path!r}",
            next="open files of one data set together",
        )
    names, expected = shard.class_names, stated_class_names(files)
    if names is not None and expected is not None and names != expected:
        found, wanted = (", ".join(each[:_NAMES_SHOWN]) for each in (names, expected))
        raise IntegrityError(
            f"{shard.path!r}, field 'label': the classes are named {found}; expected {wanted} as in the "
            "files before it",
            next="open them apart, or make them again",
        )


def stated_class_names(shards: Iterable[read.RowSource]) -> tuple[str, ...] | None:
    """Return the names of the classes as the first file that states any does; None where none does."""
    return next((shard.class_names for shard in shards if shard.class_names is not None), None)


def class_names_of(shards: Iterable[read.RowSource]) -> tuple[str, ...]:
    """Return the names of the classes as the first file states them, or else those of the digits."""
    stated = stated_class_names(shards)
    return CLASS_NAMES if stated is None else stated


def modal_touch_count(shards: Sequence[read.Shard]) -> int | None:
    """Return the T that every round of a data set must have: that of more than half of its readable rounds.

    None where rounds may differ: no T is that of more than half, or the set has a manifest. Then rounds are
    as they were made, whose checksums are known: of imported or chosen touches, or of a set of such.
    """
    if shards and catalog.manifest_beside(shards[0]) is not None:
        return None
    counts: Counter[int] = Counter()
    for shard, index in read.row_groups(shards):
        with suppress(IntegrityError):
            counts.update(stored_touch_counts(read.ChosenGroups(shard, [index])).tolist())
    modal, rounds = counts.most_common(1)[0] if counts else (0, 0)
    return modal if 2 * rounds > counts.total() else None


def stored_touch_counts(source: read.RowSource) -> Int64:
    """Return T of every row, shape (rows,), int64; reads nothing where the schema fixes it."""
    types = read.column_types(source.schema)
    name = next(name for name in ("pos_in_cell", *MEDIA_COLUMN.values()) if name in types)
    if pa.types.is_fixed_size_list(types[name]):
        return np.full(len(source), types[name].list_size, np.int64)
    counts = [block.nested(name).lengths(0) for block in read.all_blocks([source], [name])]
    return np.concatenate(counts or [np.zeros(0, np.int64)])


def checked_rows(
    groups: Iterable[tuple[read.Shard, int]],
    expected_touches: int | None,
    class_names: Sequence[str] | None,
    *,
    decode: bool = True,
    workers: int = 1,
) -> Iterator[tuple[TouchRow | None, list[Damage]]]:
    """Yield all rows of row groups with what is wrong with each; None in the place of unreadable ones.

    Arguments as of :func:`check_round`; what is found does not depend on the number of threads.
    """

    def checked(found: TouchRow | Damage) -> tuple[TouchRow | None, list[Damage]]:
        if isinstance(found, Damage):
            return None, [found]
        return found, check_round(found, expected_touches, decode=decode, class_names=class_names)

    return run.in_threads(checked, _readable_rows(groups), workers)


def _readable_rows(groups: Iterable[tuple[read.Shard, int]]) -> Iterator[TouchRow | Damage]:
    """Yield all rows, and in the place of those that cannot be read, what is wrong with them."""
    for shard, index in groups:
        try:
            yield from rows_of(shard.blocks(index))
        except IntegrityError as error:
            yield unreadable_rows(shard, index, error)


def check_round(
    row: TouchRow,
    expected_touches: int | None = None,
    *,
    decode: bool = True,
    class_names: Sequence[str] | None = None,
) -> list[Damage]:
    """List all that is wrong with one round: one entry per field of it, and one per field of each touch.

    ``expected_touches`` is the T that it must have, where that is known; the label must be one of
    ``class_names``, where those are stated. Without ``decode``, headers of images and frames are read only.
    """
    found: list[Damage] = []
    noted = partial(_noted, found, row)
    with noted():
        _ = row.read_info() if row.has_info() else None
    if row.has("id"):
        with noted():
            row.name()
    if row.has("object_id"):
        with noted():
            row.integer("object_id")
    if row.has("label"):
        with noted():
            row.label_value(class_names)
    for name in filter(row.has, PER_TOUCH_COLUMNS):
        with noted():
            # A list of fixed length would hide a null.
            if not row.group.arrow(name)[row.index].is_valid:
                raise row.damaged(name, "no values are stored")
            row.entries_of(name)
        if found and found[-1].field == "pos_in_cell":
            return found  # nothing says how many touches there should be
    count = row.touch_total()
    if expected_touches is not None and count != expected_touches:
        problem = f"{count} touches; expected {expected_touches} as in the other rounds"
        found.append(Damage(row.path, row.number, None, "pos_in_cell", problem))
    kind = row.kind
    has_poses = row.has_poses and row.has(f"{POSE_COLUMN[kind]}.quaternion")
    start, stop = row.column_of(MEDIA_COLUMN[kind]).inside(0, row.index, row.index + 1)
    sizes: dict[int, tuple[int, ...]] = {}
    for touch in range(count):
        if row.has("pos_in_cell"):
            with noted():
                row.intended_positions(touch)
        if has_poses:
            with noted():
                _ = row.pose_sequences(touch) if kind == "seq" else row.poses(touch)
        if touch < stop - start:  # where there are too few images or clips, those that are there are checked
            with noted():
                sizes[touch] = _picture_size(row, kind, touch, decode, noted)
    # Several fields may run into one fault, and say the same of it.
    return list(dict.fromkeys([*found, *_odd_sizes(row, sizes, MEDIA_COLUMN[kind])]))


@contextmanager
def _noted(found: list[Damage], row: TouchRow) -> Iterator[None]:
    """Note what is wrong instead of raising it."""
    try:
        yield
    except DamagedRoundError as error:
        found.append(error.damage)
    except (InputError, IntegrityError, ValueError) as error:
        problem = error.what if isinstance(error, ToolkitError) else str(error)
        found.append(Damage(row.path, row.number, None, "", problem))


def _picture_size(
    row: TouchRow, kind: Kind, touch: int, decode: bool, noted: Callable[[], Any]
) -> tuple[int, ...]:
    """Return height and width of an image, or of all frames of a clip; nothing of a clip without frames."""
    if kind == "single":
        images = SensorImages(row)
        return images[touch].shape[:2] if decode else images.size(touch)
    clip = TouchClip(row, touch)
    with noted():
        timed = row.has("touch_start_time_rel") and row.has("touch_end_time_rel")
        _ = clip.contact_window if timed else clip.timestamps_s
    sizes: list[tuple[int, ...]] = []
    for frame in range(len(clip)):
        with row.naming("sensor_video", touch, f"frame {frame}: "):
            data = clip.encoded(frame)
            sizes.append(decode_image(data).shape[:2] if decode else image_size(data))
            if sizes[-1] != sizes[0]:
                raise ValueError(
                    f"{_describe(sizes[-1])}; expected {_describe(sizes[0])} as of the first frame"
                )
    return sizes[0] if sizes else ()


def _odd_sizes(row: TouchRow, sizes: dict[int, tuple[int, ...]], media: str) -> Iterator[Damage]:
    """List the touches whose pictures are not of the size that most of the round are of, or the first of."""
    known = {touch: size for touch, size in sizes.items() if size}
    modal = max(known.values(), key=list(known.values()).count, default=())
    for touch, size in known.items():
        if size != modal:
            problem = f"{_describe(size)}; expected {_describe(modal)} as of the other touches"
            yield Damage(row.path, row.number, touch, media, problem)


def _describe(size: tuple[int, ...]) -> str:
    return f"{size[1]} x {size[0]} pixels"


def unreadable_file(path: str, error: ToolkitError) -> Damage:
    """Return the damage of an entire file, from the error that opening it raised."""
    words = _cause(path, error)
    named = re.fullmatch(r"field '([^']+)': (.*)", words)
    return Damage(path, None, None, *(named.groups() if named else ("", words)))


def unreadable_rows(shard: read.Shard, index: int, error: IntegrityError) -> Damage:
    """Return the damage of a row group, from the error that reading it raised; ``row`` is its first row."""
    first, stop = shard.group_starts[index], shard.group_starts[index + 1]
    rows = f"rows {first} to {stop - 1} cannot be read" if stop - first > 1 else "cannot be read"
    found = _cause(shard.path, error) if error.__cause__ is None else " ".join(str(error.__cause__).split())
    return Damage(shard.path, first, None, "", f"{rows} ({found}); expected a whole Parquet file")


def _cause(path: str, error: ToolkitError) -> str:
    """Return what an error says, without the file and the next step, which a list names once for all."""
    words = " ".join(error.what.split())
    return words.removeprefix(repr(path)).lstrip(",: ")
