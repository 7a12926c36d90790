"""Open-X-Tactile, the Zarr of FTP-1: a tactile picture for each frame, and stand-ins for camera and state.

Facts of the format (Zarr version 2): all arrays of ``data`` have a row for each frame; ``meta/episode_ends``
has the number of the first frame after each episode. A tactile group is four arrays: data (T, N, H, W, 3),
area (T, N), sensor (T,) and type (T,). Poses are x, y, z in metres and a rotation vector. The loader of the
format needs the pictures of a camera, and a state.

Data for which the format has no place are in further arrays: exact poses, intended positions, labels and all
further columns. Ids of rounds are in ``meta``, whose attributes mark the group as ours.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping

import numpy as np
import pyarrow as pa

from realtouch import importing
from realtouch.formats import episodes, zarr_groups, zarr_recordings
from realtouch.touches import poses
from tactile_toolkit import store
from tactile_toolkit.array_types import AnyArray

_TACTILE = "right_tactile_{}_gelsight"
_CAMERA, _POSE = "camera_main_rgb", "right_wrist_pose"
INSTRUCTION, TIMES = "sub_task_instruction", "timestamps"
SENSOR, PICTURE = "GelSightMini", "image"
_STAND_INS = "what_stands_for"
_BLACK = "black pictures: there was no camera"
_OF_GEL = "the pose of the gel in the frame of the cell"
_NO_POSE = "zeros: no pose is known"
_DECIMALS = 12  # of rotation vectors: their last bits depend on the processor; the exact pose is not rounded


_TACTILE_DATA = re.compile(r"[a-z]+_tactile_data_.+")
_PICTURE_AXES = 5
_MAX_SENSORS = 100


def _add_arrays(
    step: episodes.Episodes, table: pa.Table, arrays: dict[str, AnyArray]
) -> Mapping[str, object]:
    """Add the arrays of the format that follow from columns, and stand-ins; return what stands for what."""
    count, exact = len(table), arrays.get(zarr_groups.OUR_NAMES[episodes.STATE])
    pose, meaning_of_pose = np.broadcast_to(0.0, (count, 6)), _NO_POSE
    if exact is not None:
        turns = poses.Poses(exact[:, :3], exact[:, 3:]).rotvec.round(_DECIMALS)
        pose, meaning_of_pose = np.hstack([exact[:, :3], turns]), _OF_GEL
    tasks = [*(f"touch an object of class {name}" for name in step.names), "touch an object"]
    arrays.setdefault(TIMES, np.divide(table["frame_index"].to_numpy(), step.fps))
    arrays |= {
        _POSE: pose,
        _CAMERA: np.broadcast_to(np.uint8(0), (count, *step.size, 3)),
        INSTRUCTION: np.array(tasks, "<U")[arrays["label"]],  # -1 is the last
        _TACTILE.format("area"): np.broadcast_to(np.int64(0), (count, 1)),
        _TACTILE.format("sensor"): np.full(count, SENSOR),
        _TACTILE.format("type"): np.full(count, PICTURE),
    }
    return {_STAND_INS: {_CAMERA: _BLACK, _POSE: meaning_of_pose}}


plan_oxt = zarr_groups.GroupFormat(
    name="group of Open-X-Tactile",
    folder="oxt",
    pictures=_TACTILE.format("data"),
    arrays={**zarr_groups.OUR_NAMES, episodes.TIME: TIMES},
    add=_add_arrays,
    sensors=(1,),
    number=pa.float64(),
).plan


def find_oxt(
    home: store.DataFolder, columns: importing.ImportColumns, table: str | None
) -> Iterator[importing.Recording]:
    """Yield a recording for each episode; the pictures are those of the only sensor, or of the named one.

    A sensor has the name of its array. If the array holds several sensors, their numbers follow, from 0:
    ``left_tactile_data_fingers[1]``. Labels, poses and rounds that this toolkit exported are restored.
    """
    group, sensors = zarr_recordings.group_in(home), dict[str, tuple[str, int]]()
    arrays = zarr_recordings.data_arrays(group)
    for name, shape in arrays.items():
        if _TACTILE_DATA.fullmatch(name) and isinstance(shape, list) and len(shape) == _PICTURE_AXES:
            count = shape[1] if isinstance(shape[1], int) else 0
            if count == 1:
                sensors[name] = name, 0
            else:
                numbers = range(min(count, _MAX_SENSORS))
                sensors |= {f"{name}[{sensor}]": (name, sensor) for sensor in numbers}
    chosen = importing.chosen_pictures(sensors, columns.image_name, group.place, "arrays of pictures", arrays)
    return zarr_recordings.recordings_of(group, arrays, sensors[chosen], columns)
