"""Replay buffers of Diffusion Policy: groups of Zarr with the arrays ``tactile``, ``state``, ``action``."""

from __future__ import annotations

from collections.abc import Iterator

from realtouch import importing
from realtouch.exchange.episodes import ACTION, STATE
from realtouch.exchange.zarr_groups import OUR_NAMES, GroupFormat
from realtouch.exchange.zarr_recordings import (
    chosen_pictures,
    data_arrays,
    group_in,
    recordings_of,
)
from tactile_toolkit import store

PIXELS = "tactile"

plan_replay = GroupFormat(
    name="replay buffer",
    folder="replay",
    pictures=PIXELS,
    arrays={**OUR_NAMES, STATE: "state", ACTION: "action"},
).plan


def find_replay(
    home: store.DataFolder, columns: importing.ImportColumns, table: str | None
) -> Iterator[importing.Recording]:
    """Yield a recording for each episode of the buffer; its arrays are columns.

    What an array of others means does not follow from its shape; a buffer of this toolkit states its names.
    """
    group = group_in(home)
    names = data_arrays(group)
    name = chosen_pictures(group, columns.image_name or PIXELS, names)
    return recordings_of(group, names, (name, None), columns)
