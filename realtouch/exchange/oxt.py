"""Open-X-Tactile, the Zarr of FTP-1: one tactile picture a frame, and what stands for a camera and a state.

Facts of the format (Zarr version 2): all arrays of ``data`` have a row a frame; ``meta/episode_ends`` is the
number of the frame behind each episode. A tactile group is four arrays: data (T, N, H, W, 3), area (T, N),
sensor (T,) and type (T,). Poses are x, y, z in metres and a rotation vector. Its loader asks for the pictures
of a camera, and for a state.

What the format has no place for lies in further arrays: exact poses, intended positions, labels, all further
columns. Ids of rounds lie in ``meta``, whose attributes mark the group as ours.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
import pyarrow as pa

from realtouch.exchange.episodes import STATE, TIME, Episodes
from realtouch.exchange.zarr_groups import OUR_NAMES, GroupFormat
from realtouch.poses import Poses
from tactile_toolkit.array_types import AnyArray

_TACTILE = "right_tactile_{}_gelsight"
_CAMERA, _POSE = "camera_main_rgb", "right_wrist_pose"
INSTRUCTION, TIMES = "sub_task_instruction", "timestamps"
SENSOR, PICTURE = "GelSightMini", "image"

_STAND_INS = "what_stands_for"
_BLACK = "black pictures: there was no camera"
_OF_GEL = "the pose of the gel in the frame of the cell"
_NO_POSE = "zeros: no pose is known"
_DECIMALS = 12  # of rotation vectors, in whose last bits processors differ; the exact pose has all digits


def _add_arrays(step: Episodes, table: pa.Table, arrays: dict[str, AnyArray]) -> Mapping[str, object]:
    """Add the arrays of the format that follow from columns, and stand-ins; return what these are."""
    count, exact = len(table), arrays.get(OUR_NAMES[STATE])
    pose = np.broadcast_to(0.0, (count, 6))
    if exact is not None:
        turns = Poses(exact[:, :3], exact[:, 3:]).rotvec.round(_DECIMALS)
        pose = np.hstack([exact[:, :3], turns])
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
    return {_STAND_INS: {_CAMERA: _BLACK, _POSE: _NO_POSE if exact is None else _OF_GEL}}


plan_oxt = GroupFormat(
    name="group of Open-X-Tactile",
    folder="oxt",
    pictures=_TACTILE.format("data"),
    arrays={**OUR_NAMES, TIME: TIMES},
    add=_add_arrays,
    sensors=(1,),
    number=pa.float64(),
).plan
