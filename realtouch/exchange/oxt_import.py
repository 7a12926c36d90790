"""Open-X-Tactile, the Zarr of FTP-1, as recordings: an episode is a recording by one tactile sensor."""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator
from dataclasses import replace
from functools import partial

from realtouch.exchange.oxt import (
    COLUMNS,
    EXACT_POSE,
    PER_CLIP,
    POSITION,
    ROUND,
    TOUCH,
)
from realtouch.exchange.picture_arrays import columns_of
from realtouch.exchange.recordings import Recording
from realtouch.exchange.replay import ATTRIBUTES, CLASSES
from realtouch.exchange.zarr_arrays import ZarrGroup
from realtouch.exchange.zarr_recordings import (
    chosen_pictures,
    data_names,
    describe_conversion,
    encoded_frames,
    episode_ends,
    episodes_of,
    group_in,
    name_ours,
    of_episodes,
    texts,
    whole_recording,
    with_contact,
)
from realtouch.touch import touch_id
from realtouch.touch_options import POSE_COLUMNS, POSITION_COLUMNS, ImportColumns
from tactile_toolkit import store

__all__ = ["describe_conversion", "encoded_frames", "find_oxt"]
_OUR_ARRAYS = {EXACT_POSE: POSE_COLUMNS, POSITION: POSITION_COLUMNS}
_OUR_VALUES = ("label", "label_name", "object_id", *POSITION_COLUMNS)
_TACTILE = re.compile(r"[a-z]+_tactile_data_.+")
_PICTURE_AXES = 5
_MOST_SENSORS = 100


def find_oxt(home: store.DataFolder, columns: ImportColumns, table: str | None) -> Iterator[Recording]:
    """Yield a recording for each episode; the pictures are those of the only sensor, or of the named one.

    A sensor is named by its array, and its number where the array holds several, from 0:
    ``left_tactile_data_fingers[1]``. What this toolkit wrote comes back with its labels, poses and rounds.
    """
    group = group_in(home)
    names = data_names(group)
    sensors = _sensors(group, names)
    chosen = sensors[chosen_pictures(group, columns.image_name, sensors)]
    whole = whole_recording(group, names, chosen, columns)
    ends, stated = episode_ends(group, whole.frames), group.json(ATTRIBUTES)
    of_meta = [name for name in (ROUND, TOUCH) if name in group.arrays("meta")]
    meta = {name: partial(group.array, f"meta/{name}") for name in of_meta}
    said, _ = columns_of(meta, len(ends), ())
    kept = stated.get(COLUMNS)
    if ROUND not in said or not isinstance(kept, dict):
        yield from episodes_of(whole, ends, (), of_episodes(whole, columns))
        return
    per_frame = {str(kept[name]): values for name, values in whole.per_frame.items() if name in kept}
    whole = replace(whole, per_frame=per_frame, left_out=(), cut="whole" if TOUCH in said else "")
    whole = name_ours(whole, _OUR_ARRAYS, texts(stated, CLASSES))
    rounds = ids = list(map(str, said[ROUND].tolist()))
    if TOUCH in said:
        ids = list(map(touch_id, rounds, said[TOUCH].astype(int).tolist()))
    of_episode = {*_OUR_VALUES, *texts(stated, PER_CLIP)}
    for recording, name in zip(episodes_of(whole, ends, ids, of_episode), rounds, strict=True):
        yield replace(with_contact(recording), round=name)


def _sensors(group: ZarrGroup, names: Iterable[str]) -> dict[str, tuple[str, int]]:
    """Return the arrays of tactile pictures, and the sensors in each, by what names them."""
    found: dict[str, tuple[str, int]] = {}
    for name in filter(_TACTILE.fullmatch, names):
        shape = group.stated_shape(f"data/{name}")
        if len(shape) == _PICTURE_AXES and isinstance(shape[1], int) and shape[1] <= _MOST_SENSORS:
            several = {f"{name}[{sensor}]": (name, sensor) for sensor in range(shape[1])}
            found |= several if len(several) > 1 else {name: (name, 0)}
    return found
