"""Zarr groups as recordings: replay buffers and Open-X-Tactile.

An episode is a recording, and the arrays of ``data`` are its columns.
"""

from __future__ import annotations

import re
from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import replace
from functools import partial
from itertools import pairwise

import numpy as np
import pyarrow as pa

from realtouch import touch_options
from realtouch.formats import picture_arrays, zarr_arrays
from realtouch.formats.exports import CONTACT
from realtouch.importing import import_options, source_files, source_touches
from realtouch.touches.rounds import touch_id
from tactile_toolkit import errors, store, wording
from tactile_toolkit.columns import column_types
from tactile_toolkit.value_types import Int64

ENDS, ATTRIBUTES = "meta/episode_ends", "meta/.zattrs"
ROUND, TOUCH = "round_id", "touch"
"""Arrays of ``meta`` with an entry for each episode; the second exists if episodes are clips."""
CLASSES, COLUMNS, PER_CLIP = "class_names", "columns", "columns_of_clips"
"""Attributes of ``meta``: classes, columns of the data set by array, those that concern whole clips."""
DATA = "data"
TIMES = ("time_s", "timestamps", "timestamp")
"""Names of the array of times of pictures, in order of preference; it has floats, in seconds."""
PIXELS = "tactile"
"""Array of pictures in replay buffers of this toolkit."""

_TACTILE_DATA = re.compile(r"[a-z]+_tactile_data_.+")
_PICTURE_AXES = 5
_MAX_SENSORS = 100
_ENDINGS = (".zarr", ".zarr.zip")
_ENDS_SHOWN = 8
_MAX_ARRAYS = 500
_META_ARRAYS = (ROUND, TOUCH)
_OUR_VECTORS = {"gel_pose": touch_options.POSE_COLUMNS, "pos_in_cell": touch_options.POSITION_COLUMNS}
_OUR_VALUES = ("label", "label_name", "object_id", *touch_options.POSITION_COLUMNS)


def find_replay(
    home: store.DataFolder,
    columns: import_options.ImportColumns,
    table: str | None,
    ledger: source_files.Ledger,
) -> Iterator[source_touches.Recording]:
    """Yield a recording for each episode of the buffer; its arrays are columns.

    The meaning of an array does not follow from its shape; only a buffer of this toolkit states its columns.
    """
    group = group_in(home)
    ledger.use(group.home, group.path)
    names = data_arrays(group)
    name = source_files.chosen_pictures(names, columns.image_name or PIXELS, group.address, "arrays")
    return recordings_of(group, names, (name, None), columns)


def find_oxt(
    home: store.DataFolder,
    columns: import_options.ImportColumns,
    table: str | None,
    ledger: source_files.Ledger,
) -> Iterator[source_touches.Recording]:
    """Yield a recording for each episode; the pictures are those of the only sensor, or of the named one.

    A sensor has the name of its array. If the array holds several sensors, their numbers follow, from 0:
    ``left_tactile_data_fingers[1]``. Labels, poses and rounds that this toolkit exported are restored.
    """
    group = group_in(home)
    ledger.use(group.home, group.path)
    sensors = dict[str, tuple[str, int]]()
    arrays = data_arrays(group)
    for name, shape in arrays.items():
        if _TACTILE_DATA.fullmatch(name) and isinstance(shape, list) and len(shape) == _PICTURE_AXES:
            count = shape[1] if isinstance(shape[1], int) else 0
            if count == 1:
                sensors[name] = name, 0
            else:
                numbers = range(min(count, _MAX_SENSORS))
                sensors |= {f"{name}[{sensor}]": (name, sensor) for sensor in numbers}
    advice = ""
    others = [name for name, shape in arrays.items() if isinstance(shape, list) and len(shape) == 4]
    if others:
        advice = f"--format replay --map image={others[0]} imports another array as the pictures"
    chosen = source_files.chosen_pictures(
        sensors, columns.image_name, group.address, "arrays of pictures", arrays, advice
    )
    return recordings_of(group, arrays, sensors[chosen], columns)


def group_in(home: store.DataFolder) -> zarr_arrays.ZarrGroup:
    """Return the group that a folder or zip is, or the only one that it holds."""
    if home.address().lower().endswith(".zip"):
        return zarr_arrays.ZarrGroup(*source_files.source_of(home.address()))
    if home.exists(".zgroup") or home.exists("zarr.json"):
        return zarr_arrays.ZarrGroup(home, "")
    names = [name for name in home.names() if name.lower().endswith(_ENDINGS) and not store.is_hidden(name)]
    if len(names) != 1:
        raise errors.InputError(
            f"{home.address()!r} should hold one Zarr group; found {', '.join(names) or 'none'}",
            next="give the folder or zip of one group",
        )
    return zarr_arrays.ZarrGroup(home, names[0])


def data_arrays(group: zarr_arrays.ZarrGroup) -> dict[str, object]:
    """Return the shapes of the arrays of ``data``, as stated; InputError without any, or for too many."""
    names = group.arrays(DATA)
    if not 0 < len(names) <= _MAX_ARRAYS:
        raise errors.InputError(
            f"{group.address!r} has {len(names) or 'no'} arrays in its group 'data'; "
            f"expected a replay buffer or Open-X-Tactile, with at most {_MAX_ARRAYS} arrays",
            next="give the group itself; a zip must hold what is inside the group's folder",
        )
    return names


def recordings_of(
    group: zarr_arrays.ZarrGroup,
    names: Iterable[str],
    pictures: tuple[str, int | None],
    columns: import_options.ImportColumns,
) -> Iterator[source_touches.Recording]:
    """Return all episodes; ``pictures`` is an array of ``data``, and the number of the sensor in it.

    Columns that this toolkit wrote get their own names again. Raises InputError if the array has no pictures,
    or if a named column cannot be used.
    """
    name, sensor = pictures
    shown = picture_arrays.PictureArray.of(group.array(f"{DATA}/{name}", holds_pictures=True), sensor)
    part = f"{shown.divisor!r} {'' if sensor is None else sensor} {DATA}/{name}"
    ignored = {name, *(array for array, source in columns.extra if not source)}
    arrays = {array: partial(group.array, f"{DATA}/{array}") for array in names if array not in ignored}
    meta_arrays = {
        array: partial(group.array, f"meta/{array}")
        for array in group.arrays("meta")
        if array in _META_ARRAYS
    }
    per_frame, left_out = picture_arrays.columns_of(arrays, len(shown), columns)
    for array, count in group.absent.items():
        if count:
            chunks = wording.with_count(count, "chunks")
            left_out.append(f"{array.removeprefix('data/')} ({chunks} not stored, taken as the fill value)")
    source = (name, group.home.address(), group.path, part)
    whole = source_touches.Recording(
        *source,
        0,
        len(shown),
        shown.picture_bytes,
        per_frame=per_frame,
        left_out=tuple(left_out),
        conversions=shown.conversions,
    )
    ends = episode_ends(group, len(shown))
    stated = group.json(ATTRIBUTES)
    meta, _ = picture_arrays.columns_of(meta_arrays, len(ends), columns)
    kept = stated.get(COLUMNS)
    if ROUND not in meta or not isinstance(kept, dict):
        return split_episodes(whole, ends, (), episode_columns(whole, columns))
    per_frame = {str(own): per_frame[name] for name, own in kept.items() if name in per_frame}
    whole = replace(whole, per_frame=per_frame, left_out=())
    round_ids = ids = list(map(str, meta[ROUND].to_pylist()))
    if TOUCH in meta:
        whole = replace(whole, cut="whole")
        ids = list(map(touch_id, round_ids, map(int, meta[TOUCH].to_pylist())))
    episodes = our_episodes(whole, ends, ids, _texts(stated, CLASSES), _texts(stated, PER_CLIP))
    return (replace(episode, round=name) for episode, name in zip(episodes, round_ids, strict=True))


def our_episodes(
    whole: source_touches.Recording,
    ends: Int64,
    names: Sequence[str],
    class_names: Sequence[str],
    names_of_clips: Sequence[str],
) -> Iterator[source_touches.Recording]:
    """Divide a recording that this toolkit wrote into episodes, with the columns of its tables."""
    whole = restore_column_names(whole, _OUR_VECTORS, class_names)
    return map(with_contact, split_episodes(whole, ends, names, {*_OUR_VALUES, *names_of_clips}))


def _open_pictures(home: store.DataFolder, path: str, part: str) -> picture_arrays.PictureArray:
    divisor, sensor, name = part.split(" ", 2)
    array = zarr_arrays.ZarrGroup(home, path).array(name, holds_pictures=True)
    return picture_arrays.PictureArray(array, float(divisor), int(sensor) if sensor else None)


read_contents = partial(picture_arrays.read_contents, opened=_open_pictures)


def episode_ends(group: zarr_arrays.ZarrGroup, frames: int) -> Int64:
    """Return the number of the first frame after each episode.

    Raises InputError unless the numbers rise, and the last one is the number of all frames.
    """
    array = group.array(ENDS)
    ends = np.zeros(0, np.int64)
    if len(array.shape) == 1 and array.dtype.kind in "iu" and array.shape[0] <= frames:
        ends = array.rows().astype(np.int64)
    if not len(ends) or ends[-1] != frames or (np.diff(ends, prepend=0) <= 0).any():
        raise array.refused(
            f"episodes end at {array.dtype} {array.shape}: {', '.join(map(str, ends[:_ENDS_SHOWN].tolist()))}"
            f"; expected integers that rise to {frames:,}, the number of frames"
        )
    return ends


def episode_columns(whole: source_touches.Recording, columns: import_options.ImportColumns) -> set[str]:
    """Return the columns that may describe whole episodes: labels, objects, rounds, splits and all texts."""
    known = columns.found_in(whole.per_frame)
    stated = {source_files.NUMBERED, known.label, known.object_id, known.round, known.split}
    return {
        name for name, column in whole.per_frame.items() if name in stated or pa.types.is_string(column.type)
    }


def split_episodes(
    whole: source_touches.Recording, ends: Int64, names: Sequence[str], of_episode: Collection[str]
) -> Iterator[source_touches.Recording]:
    """Divide a recording into episodes; their default names are ``episode-000000`` and so on.

    A column of ``of_episode`` becomes a value of each episode, if it does not change within any episode.
    """
    names = names or [f"episode-{episode:06d}" for episode in range(len(ends))]
    starts = np.append(0, ends[:-1])
    per_frame = dict(whole.per_frame)
    lengths = ends - starts
    firsts = pa.array(starts)
    of_rows = pa.array(np.repeat(np.arange(len(ends)), lengths))
    constant = {}
    for name in [name for name in per_frame if name in of_episode]:  # in order, so that bytes are the same
        values = per_frame[name].take(firsts)
        if _is_same(per_frame[name], values.take(of_rows)):
            constant[name] = values
    time = next((name for name in TIMES if _holds_times(per_frame.get(name), starts)), None)
    times = None if time is None else per_frame[time].to_numpy()
    per_frame = {name: column for name, column in per_frame.items() if name not in constant}
    if time == source_touches.TIME_S:
        per_frame.pop(source_touches.TIME_S, None)
    for number, (start, end) in enumerate(pairwise([0, *ends.tolist()])):
        values = {name: constant_values[number].as_py() for name, constant_values in constant.items()}
        yield replace(
            whole,
            name=names[number],
            first=whole.first + start,
            frames=end - start,
            values={**whole.values, **values},
            per_frame={name: column.slice(start, end - start) for name, column in per_frame.items()},
            time_s=None if times is None else times[start:end],
        )


def _is_same(column: pa.Array, constant: pa.Array) -> bool:
    if pa.types.is_floating(column.type):  # NaN is a missing value, too
        first, second = column_types.floats_of(column), column_types.floats_of(constant)
        return np.array_equal(first, second, equal_nan=True)
    return bool(column.equals(constant))


def _holds_times(column: pa.Array | None, starts: Int64) -> bool:
    """Return whether a column holds seconds that do not decrease within any episode."""
    if column is None or not pa.types.is_floating(column.type) or column.null_count:
        return False
    times = column.to_numpy()
    falls = np.flatnonzero(times[1:] < times[:-1]) + 1
    return bool(np.isfinite(times).all() and np.isin(falls, starts).all())


def _texts(stated: Mapping[str, object], name: str) -> list[str]:
    """Return a list of texts from attributes; empty if they have no such list."""
    texts = stated.get(name)
    return [str(text) for text in texts] if isinstance(texts, list) else []


def restore_column_names(
    whole: source_touches.Recording, vectors: Mapping[str, Sequence[str]], class_names: Sequence[str]
) -> source_touches.Recording:
    """Return a recording that this toolkit wrote, with the column names of its tables."""
    per_frame = dict(whole.per_frame)
    for name, names in vectors.items():
        if name in per_frame:
            with suppress(ValueError):  # other columns keep the name of their array
                columns = np.atleast_2d(column_types.floats_of(per_frame[name]).T)
                if len(columns) <= len(names):
                    del per_frame[name]
                    per_frame |= {
                        own_name: pa.array(part) for own_name, part in zip(names, columns, strict=False)
                    }
    label = per_frame.get(source_files.NUMBERED)
    if label is not None and pa.types.is_integer(label.type) and not label.null_count:
        numbers = label.to_numpy()
        known = pa.array([*class_names, None], pa.string())
        is_known = (numbers >= 0) & (numbers < len(class_names))
        per_frame[f"{source_files.NUMBERED}_name"] = known.take(
            pa.array(np.where(is_known, numbers, len(class_names)))
        )
    return replace(whole, per_frame=per_frame)


def with_contact(recording: source_touches.Recording) -> source_touches.Recording:
    """Return a clip that this toolkit wrote, with its first and last picture of contact if it states them."""
    per_frame = dict(recording.per_frame)
    stated = per_frame.pop(CONTACT, None)
    contact = None
    if stated is not None:
        in_contact = np.flatnonzero(np.array(stated.to_pylist(), object)).tolist()
        if in_contact:
            contact = in_contact[0], in_contact[-1]
    return replace(recording, per_frame=per_frame, contact=contact)
