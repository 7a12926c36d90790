"""Replay buffers of Diffusion Policy as recordings: an episode is a recording, a frame is a picture."""

from __future__ import annotations

from collections.abc import Iterator

from realtouch.exchange.recordings import Recording
from realtouch.exchange.replay import CLASSES, IDS, PIXELS
from realtouch.exchange.zarr_recordings import (
    ATTRIBUTES,
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
)
from realtouch.touch_options import POSE_COLUMNS, POSITION_COLUMNS, ImportColumns
from tactile_toolkit import store

__all__ = ["describe_conversion", "encoded_frames", "find_replay"]
_OUR_ARRAYS = {"state": POSE_COLUMNS, "action": POSITION_COLUMNS}


def find_replay(home: store.DataFolder, columns: ImportColumns, table: str | None) -> Iterator[Recording]:
    """Yield a recording for each episode of the buffer; its arrays are columns.

    What an array of others means does not follow from its shape; a buffer of this toolkit states its names.
    """
    group = group_in(home)
    names = data_names(group)
    name = chosen_pictures(group, columns.image_name or PIXELS.rpartition("/")[2], names)
    whole = whole_recording(group, names, (name, None), columns)
    ends, stated = episode_ends(group, whole.frames), group.json(ATTRIBUTES)
    ids = texts(stated, IDS)
    if len(ids) == len(ends):
        whole = name_ours(whole, _OUR_ARRAYS, texts(stated, CLASSES))
    else:
        ids = []
    yield from episodes_of(whole, ends, ids, of_episodes(whole, columns))
