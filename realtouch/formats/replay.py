"""Replay buffers of Diffusion Policy: Zarr groups with the arrays ``tactile``, ``state`` and ``action``."""

from __future__ import annotations

from collections.abc import Iterator

from realtouch import importing
from realtouch.formats import episodes, zarr_groups, zarr_recordings
from tactile_toolkit import store

PIXELS = "tactile"

plan_replay = zarr_groups.GroupFormat(
    name="replay buffer",
    folder="replay",
    pictures=PIXELS,
    arrays={**zarr_groups.OUR_NAMES, episodes.STATE: "state", episodes.ACTION: "action"},
).plan


def find_replay(
    home: store.DataFolder, columns: importing.ImportColumns, table: str | None
) -> Iterator[importing.Recording]:
    """Yield a recording for each episode of the buffer; its arrays are columns.

    The meaning of an array does not follow from its shape; only a buffer of this toolkit states its columns.
    """
    group = zarr_recordings.group_in(home)
    names = zarr_recordings.data_arrays(group)
    name = importing.chosen_pictures(names, columns.image_name or PIXELS, group.place, "arrays")
    return zarr_recordings.recordings_of(group, names, (name, None), columns)
