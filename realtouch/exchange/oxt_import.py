"""Open-X-Tactile, the Zarr of FTP-1, as recordings: an episode is a recording by one tactile sensor."""

from __future__ import annotations

import re
from collections.abc import Iterator

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

__all__ = ["describe_conversion", "encoded_frames", "find_oxt"]
_TACTILE = re.compile(r"[a-z]+_tactile_data_.+")
_PICTURE_AXES = 5
_MOST_SENSORS = 100


def find_oxt(home: store.DataFolder, columns: ImportColumns, table: str | None) -> Iterator[Recording]:
    """Yield a recording for each episode; the pictures are those of the only sensor, or of the named one.

    A sensor is named by its array, and its number where the array holds several, from 0:
    ``left_tactile_data_fingers[1]``. What this toolkit wrote comes back with its labels, poses and rounds.
    """
    group, sensors = group_in(home), dict[str, tuple[str, int]]()
    arrays = data_arrays(group)
    for name, shape in arrays.items():
        if _TACTILE.fullmatch(name) and isinstance(shape, list) and len(shape) == _PICTURE_AXES:
            count = shape[1] if isinstance(shape[1], int) else 0
            several = {f"{name}[{sensor}]": (name, sensor) for sensor in range(min(count, _MOST_SENSORS))}
            sensors |= {name: (name, 0)} if count == 1 else several
    return recordings_of(group, arrays, sensors[chosen_pictures(group, columns.image_name, sensors)], columns)
