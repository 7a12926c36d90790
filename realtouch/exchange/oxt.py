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
from dataclasses import dataclass, replace

import numpy as np
import pyarrow as pa

from realtouch.contact import ContactMethod
from realtouch.convert.conversion import Choices, Conversion, Source
from realtouch.exchange.episodes import ACTION, CONTACT, STATE, TIME, Episodes, only_split
from realtouch.exchange.replay import (
    ATTRIBUTES,
    CHUNK_BYTES,
    CLASSES,
    ENDS,
    WriteGroup,
    ends_of,
    fill_of,
    numbers,
)
from realtouch.exchange.zarr_arrays import ZarrWriter
from realtouch.poses import Poses
from tactile_toolkit.array_types import AnyArray, Int64

FOLDER = "oxt"
TACTILE = "right_tactile_{}_gelsight"
CAMERA, POSE, INSTRUCTION, TIMES = "camera_main_rgb", "right_wrist_pose", "sub_task_instruction", "timestamps"
SENSOR, PICTURE = "GelSightMini", "image"
EXACT_POSE, POSITION = "gel_pose", "pos_in_cell"
ROUND, TOUCH = "round_id", "touch"
"""Arrays of ``meta`` with an entry an episode; the second, if episodes are clips."""

COLUMNS, PER_CLIP = "columns", "columns_of_clips"
"""Attributes of ``meta``: columns of the data set by array, and which of these concern whole clips."""

_STAND_INS = "what_stands_for"
_BLACK = "black pictures: there was no camera"
_OF_GEL = "the pose of the gel in the frame of the cell"
_NO_POSE = "zeros: no pose is known"
_ARRAYS = {
    **{STATE: EXACT_POSE, ACTION: POSITION, CONTACT: CONTACT},
    **{name: name for name in ("label", "object_id")},
}
_DECIMALS = 12  # of rotation vectors, in whose last bits processors differ; EXACT_POSE has all digits


def plan_oxt(
    source: Source, choices: Choices, method: ContactMethod, options: Mapping[str, object]
) -> Conversion:
    """Plan an Open-X-Tactile group; reads footers and one header. InputError for several splits."""
    step = Episodes.of(source, only_split(source, choices, "group of Open-X-Tactile"))
    options = {**options, "image_size": [step.size[1], step.size[0]]}
    write = _WriteOxt(step.size, step.names, step.extras, step.fps)
    step = replace(step, number=pa.float64())
    return Conversion(source, "export", options, step, choices, extra_dirs=(FOLDER,), write_files=write)


@dataclass(frozen=True)
class _WriteOxt(WriteGroup):
    """Writes the group."""

    fps: int
    file = f"{FOLDER}/touches.zarr.zip"
    pictures = f"data/{TACTILE.format('data')}"
    sensors = (1,)

    def add_columns(self, group: ZarrWriter, table: pa.Table, starts: Int64) -> None:
        """Add all arrays but the pictures, in chunks; those of zeros have none."""
        columns = {name: table[name].combine_chunks() for name in table.schema.names}
        arrays = {name: numbers(columns[each]) for each, name in _ARRAYS.items() if each in columns}
        arrays |= {each.array: numbers(columns[each.name]) for each in self.extras}
        kept = {name: name for name in arrays} | {each.array: each.own_name for each in self.extras}
        of_clips = [each.own_name for each in self.extras if not each.is_per_frame]
        if TIME in columns:
            kept[TIMES] = "time_s"
        stands = {CAMERA: _BLACK, POSE: _OF_GEL if EXACT_POSE in arrays else _NO_POSE}
        group.add_json(
            ATTRIBUTES, {CLASSES: self.names, COLUMNS: kept, PER_CLIP: of_clips, _STAND_INS: stands}
        )
        _add(group, ENDS, ends_of(table, starts))
        firsts = table.take(starts)
        _add(group, f"meta/{ROUND}", np.array(firsts["round_id"].to_pylist(), "<U"))
        if "touch" in columns:
            _add(group, f"meta/{TOUCH}", firsts["touch"].to_numpy())
        for name, values in (arrays | self._made(arrays, columns)).items():
            _add(group, f"data/{name}", values)
        nothing = np.zeros(len(table), np.int64)
        _add(group, f"data/{TACTILE.format('sensor')}", np.array([SENSOR], "<U"), nothing)
        _add(group, f"data/{TACTILE.format('type')}", np.array([PICTURE], "<U"), nothing)
        tasks = [*(f"touch an object of class {name}" for name in self.names), "touch an object"]
        _add(group, f"data/{INSTRUCTION}", np.array(tasks, "<U"), arrays["label"])  # -1 is the last
        group.describe(f"data/{CAMERA}", (len(table), *self.size, 3), (1, *self.size, 3), "|u1")

    def _made(self, arrays: Mapping[str, AnyArray], columns: Mapping[str, pa.Array]) -> dict[str, AnyArray]:
        """Return the arrays of the format that follow from columns."""
        times, pose = columns.get(TIME), np.zeros((len(arrays["label"]), 6))
        if times is None:
            times = np.divide(columns["frame_index"], self.fps)
        if EXACT_POSE in arrays:
            exact = arrays[EXACT_POSE]
            turns = Poses(exact[:, :3], exact[:, 3:]).rotvec.round(_DECIMALS)
            pose = np.hstack([exact[:, :3], turns])
        area = np.zeros((len(pose), 1), "<i8")
        return {TIMES: np.asarray(times, "<f8"), POSE: pose, TACTILE.format("area"): area}


def _add(group: ZarrWriter, path: str, values: AnyArray, rows: Int64 | None = None) -> None:
    """Add an array, or some rows of it, in chunks along the first axis; chunks of zeros are not stored."""
    count = len(values if rows is None else rows)
    length = max(1, min(count, CHUNK_BYTES // values[:1].nbytes))
    group.describe(
        path, (count, *values.shape[1:]), (length, *values.shape[1:]), values.dtype.str, fill_of(values)
    )
    for number, start in enumerate(range(0, count, length)):
        part = values[slice(start, start + length) if rows is None else rows[start : start + length]]
        chunk = np.zeros((length, *values.shape[1:]), values.dtype)
        chunk[: len(part)] = part
        if chunk.any():
            group.chunk(path, number, chunk)
