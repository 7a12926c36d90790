"""Replay buffers of Diffusion Policy as touches: an episode is a round, a frame is a touch."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Sequence
from itertools import pairwise
from typing import Any

import numpy as np

from realtouch.exchange.fields import NUMBERED
from realtouch.exchange.found_touches import FoundTouch, source_of
from realtouch.exchange.picture_arrays import PictureArray
from realtouch.exchange.replay import ATTRIBUTES, CLASSES, ENDS, IDS, PIXELS
from realtouch.exchange.zarr_arrays import ZarrArray, ZarrGroup
from realtouch.touch_options import POSE_COLUMNS, POSITION_COLUMNS, ImportColumns
from tactile_toolkit import store
from tactile_toolkit.array_types import AnyArray
from tactile_toolkit.errors import InputError, ItemError
from tactile_toolkit.touch import encode_image

_OUR_ARRAYS = {"state": POSE_COLUMNS, "action": POSITION_COLUMNS}
_ENDINGS = (".zarr", ".zarr.zip")
_ENDS_SHOWN = 8


def describe_conversion(items: Sequence[FoundTouch]) -> str:
    """Return what is done to the pictures of a buffer; empty if they are taken as they are."""
    return _pictures(items[0]).described()


def _pictures(item: FoundTouch) -> PictureArray:
    """Open the pictures that an item is one of."""
    divisor, _, name = item.part.partition(" ")
    return PictureArray(ZarrGroup(store.open_folder(item.home), item.path).array(name), float(divisor))


def find_replay(home: store.DataFolder, columns: ImportColumns, table: str | None) -> Iterator[FoundTouch]:
    """Yield a touch for each frame of the buffer; an episode is a round, other arrays are its fields.

    Only arrays that a column names are read. What an array of others means does not follow from its shape.
    """
    home, path = _group_in(home)
    group = ZarrGroup(home, path)
    names = group.arrays("data")
    if not names:
        raise InputError(
            f"{group.place!r} has no arrays in its group 'data'; expected a replay buffer",
            next="give the group itself; a zip holds what is inside of the group's folder",
        )
    name = columns.image_name or PIXELS.rpartition("/")[2]
    if name not in names:
        raise InputError(
            f"{group.place!r} has no array of pictures {name!r}; found {', '.join(names)}",
            next="name it with --map image=NAME",
        )
    pictures = PictureArray.of(group.array(f"data/{name}"))
    ends, stated = _episode_ends(group.array(ENDS), len(pictures)), group.json(ATTRIBUTES)
    ids, class_names = ([str(each) for each in stated.get(key) or ()] for key in (IDS, CLASSES))
    is_ours = len(ids) == len(ends)
    stems = [f"episode-{episode:06d}" for episode in range(len(ends))]
    wanted = {*columns.found_in(names).names(), NUMBERED}
    if is_ours:
        wanted.update(_OUR_ARRAYS)
    else:
        ids = stems
    others = dict.fromkeys((each for each in names if each != name), "not read")
    fields = {each: _rows(group.array(f"data/{each}"), len(pictures)) for each in others if each in wanted}
    part, size = f"{pictures.divisor!r} data/{name}", math.prod(pictures.shape[1:])
    for stem, round_id, (start, end) in zip(stems, ids, pairwise([0, *ends]), strict=True):
        for number in range(start, end):
            values = {**others, **{field: array[number].tolist() for field, array in fields.items()}}
            if is_ours:
                _name_ours(values, class_names)
            values.setdefault("round_id", round_id)
            frame = f"{stem}_{number - start:06d}.png"
            yield FoundTouch(frame, home.address(), path, number, size, values, part=part)


def _name_ours(values: dict[str, Any], class_names: Sequence[str]) -> None:
    """Give the fields of a buffer that this toolkit wrote the names that they have in its tables."""
    for name, names in _OUR_ARRAYS.items():
        values |= dict(zip(names, np.ravel(values.pop(name, ())).tolist(), strict=False))
    label = values.get(NUMBERED)
    if isinstance(label, int) and 0 <= label < len(class_names):
        values[f"{NUMBERED}_name"] = class_names[label]


def _episode_ends(array: ZarrArray, frames: int) -> list[int]:
    """Return the number of the frame behind each episode; InputError unless they rise to all frames."""
    ends: list[int] = []
    if len(array.shape) == 1 and array.dtype.kind in "iu" and array.shape[0] <= frames:
        ends = array.rows(0, array.shape[0]).tolist()
    if not ends or ends[-1] != frames or any(end <= start for start, end in pairwise([0, *ends])):
        found = f"{array.dtype} {array.shape}: {', '.join(map(str, ends[:_ENDS_SHOWN]))}"
        expected = f"integers that rise to {frames:,}, the number of frames"
        raise array.group.refused(array.path, f"episodes end at {found}; expected {expected}")
    return ends


def _rows(array: ZarrArray, frames: int) -> AnyArray:
    """Read what is known of each frame; InputError for another number of rows, or tables in it."""
    if array.shape[:1] != (frames,) or len(array.shape) > 2:
        expected = f"{frames:,} rows of numbers, as frames"
        raise array.group.refused(array.path, f"an array {array.shape}; expected {expected}")
    rows = array.rows(0, frames)
    return rows[:, 0] if rows.shape[1:] == (1,) else rows


def encoded_frames(items: Iterable[FoundTouch]) -> Iterator[bytes | ItemError]:
    """Yield the pixels of each frame as PNG, in order; a chunk of the array is unpacked once."""
    shown, last, chunk = ("", "", ""), -1, np.zeros(0, np.uint8)
    pictures: Any = None
    for item in items:
        if shown != (item.home, item.path, item.part):
            shown, last, pictures = (item.home, item.path, item.part), -1, _pictures(item)
        length = pictures.array.chunks[0]
        if item.start // length != last:
            last = item.start // length
            chunk = pictures.pixels(last * length, min((last + 1) * length, len(pictures)))
        yield encode_image(chunk[item.start % length], "png")


def _group_in(home: store.DataFolder) -> tuple[store.DataFolder, str]:
    """Return where the group lies that a folder or zip is, or the only one that it holds."""
    if home.address().lower().endswith(".zip"):
        return source_of(home.address())
    if home.exists(".zgroup") or home.exists("zarr.json"):
        return home, ""
    names = [name for name in home.names() if name.lower().endswith(_ENDINGS) and not store.is_hidden(name)]
    if len(names) != 1:
        raise InputError(f"{home.address()!r} should hold one Zarr group; found {', '.join(names) or 'none'}")
    return home, names[0]
