"""Depth maps in LeRobotDatasets: lossless TIFF of float32 in metres, as LeRobot 0.6 stores depth.

Facts of the format: a feature of maps has one channel, and ``info`` with ``is_depth_map`` and ``depth_unit``,
which is ``m`` or ``mm``. Statistics are in that unit, while those of colours are scaled to 1.
"""

from __future__ import annotations

import io
from collections.abc import Iterable

import numpy as np
import pyarrow as pa
from PIL import Image

from realtouch.touches import media, stored_round
from tactile_toolkit.array_types import Float32, Float64, Int64
from tactile_toolkit.touch import MEDIA_TYPE

INFO = {"is_depth_map": True, "depth_unit": "m"}
NUMBER_BYTES = 4  # of float32


def depth_of(row: stored_round.StoredRound, size: tuple[int, int]) -> pa.Array:
    """Return the encoded depth maps of a round; IntegrityError for a map of another size."""
    files = []
    for touch, depth_m in enumerate(media.DepthMaps(row, media.DEPTH)):
        if depth_m.shape != size:
            raise row.damaged(media.DEPTH, f"a map {depth_m.shape}; expected {size} as the images", touch)
        files.append({"bytes": _tiff(depth_m), "path": f"{row.name()}_{touch:03d}.tiff"})
    return pa.array(files, MEDIA_TYPE)


def _tiff(depth_m: Float32) -> bytes:
    stream = io.BytesIO()
    Image.fromarray(depth_m).save(stream, "TIFF")
    return stream.getvalue()


def counted_depths(files: Iterable[bytes]) -> tuple[Float64, Int64]:
    """Return the sorted values of some maps, and how often each occurs."""
    maps = [np.asarray(Image.open(io.BytesIO(each), formats=["TIFF"]), np.float64) for each in files]
    values, counts = np.unique(np.concatenate(maps), return_counts=True)
    return values, counts
