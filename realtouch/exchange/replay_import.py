"""Replay buffers of Diffusion Policy as recordings: an episode is a recording, a frame is a picture."""

from __future__ import annotations

from collections.abc import Iterator

from realtouch.exchange.replay import PIXELS
from realtouch.exchange.zarr_recordings import (
    chosen_pictures,
    data_arrays,
    describe_conversion,
    encoded_frames,
    group_in,
    recordings_of,
)
from realtouch.import_columns import ImportColumns
from realtouch.importing.recordings import Recording
from tactile_toolkit import store

__all__ = ["describe_conversion", "encoded_frames", "find_replay"]


def find_replay(home: store.DataFolder, columns: ImportColumns, table: str | None) -> Iterator[Recording]:
    """Yield a recording for each episode of the buffer; its arrays are columns.

    What an array of others means does not follow from its shape; a buffer of this toolkit states its names.
    """
    group = group_in(home)
    names = data_arrays(group)
    name = chosen_pictures(group, columns.image_name or PIXELS, names)
    return recordings_of(group, names, (name, None), columns)
