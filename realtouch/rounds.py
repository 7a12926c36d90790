"""Rounds: typed, frozen records of all touches of one object."""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from types import MappingProxyType
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray

from dataset_store.records import Record, Row
from dataset_store.rowgroups import RowGroup
from realtouch.clips import SensorClips
from realtouch.contact import require_method
from realtouch.damage import damaged, missing_column
from realtouch.fields import (
    clip_lengths,
    frame_times,
    media_count,
    pose_sequences,
    poses,
    touch_durations,
    touch_total,
    vectors,
)
from realtouch.images import SensorImages, in_parallel, positions_of
from realtouch.jpeg import Pixels
from realtouch.poses import Poses, PoseSequences, bad_pose, rigid_transform
from realtouch.published import flat_table, take_touches
from realtouch.round_frames import contact_frames_of, contact_windows_of, decode_frames

__all__ = ["TouchRound", "TouchSeqRound", "TouchSingleRound"]

_MOST_THREADS = 4


class TouchRound(Record):
    """T touches of one object; fields are loaded on first use.

    Poses and positions are metres in the cell frame: origin at the cell centre, x right of the robot, y away
    from it, z up. Iterate :meth:`realtouch.TouchDataset.touches` for single touches.
    """

    __slots__ = ()

    @property
    def id(self) -> str:
        """Name of the round, such as ``2023-09-28_15-50-43_7-0``."""
        return str(self._plain("id"))

    @property
    def label(self) -> int:
        """Class of the object; the digit, 0 to 9, in the MNIST sets."""
        return self._whole_number("label")

    @property
    def object_id(self) -> int:
        """Id of the touched mesh in its data set of meshes."""
        return self._whole_number("object_id")

    @property
    def info(self) -> Mapping[str, Any]:
        """Metadata such as ``gel_id`` and notes, unflattened; pairs of position and quaternion are poses."""
        return self._once("info", self._read_info)

    @property
    def pos_in_cell_m(self) -> NDArray[np.floating]:
        """Intended positions, shape (T, 2), metres, cell frame; a read-only view."""
        return vectors(self._row, "pos_in_cell", 2)

    @property
    def pos_in_cell(self) -> NDArray[np.floating]:
        """The published name of :attr:`pos_in_cell_m`."""
        return self.pos_in_cell_m

    @property
    def touch_count(self) -> int:
        """T, the number of touches."""
        return touch_total(self._row)

    def with_touches(self, touches: Sequence[int]) -> Self:
        """Return a round of some of the touches, in the order given; a copy of their stored bytes."""
        row = self._row
        table = flat_table(row.group.table.slice(row.index, 1))
        chosen = take_touches(table, touches, self.touch_count)
        return type(self)(Row(RowGroup(chosen, row.path, row.number), 0))

    def _plain(self, name: str) -> Any:
        try:
            value = self._row.value(name)
        except KeyError as error:
            raise missing_column(self._row, name) from error
        if value is None:
            raise damaged(self._row, name, "no value is stored")
        return value

    def _whole_number(self, name: str) -> int:
        value = self._plain(name)
        if not np.isfinite(value) or int(value) != value or value < 0:
            raise damaged(self._row, name, f"the value is {value}; expected a whole number of 0 or more")
        return int(value)

    def _read_info(self) -> Mapping[str, Any]:
        names = [name for name in self._row.group.names if name.startswith("info.")]
        if not names and not self._row.has("info"):
            raise missing_column(self._row, "info")
        nested: dict[str, Any] = {}
        for name in names:
            *outer, last = name.split(".")[1:]
            place = nested
            for part in outer:
                place = place.setdefault(part, {})
            place[last] = self._row.group.arrow(name)[self._row.index].as_py()
        return MappingProxyType(self._with_poses(nested, "info"))

    def _with_poses(self, values: dict[str, Any], name: str) -> Any:
        if values.keys() == {"position", "quaternion"}:
            return self._info_pose(values, name)
        return {
            key: self._with_poses(value, f"{name}.{key}") if isinstance(value, dict) else value
            for key, value in values.items()
        }

    def _info_pose(self, values: dict[str, Any], name: str) -> Any:
        """Make the pose, or the poses where there is one per touch."""
        position, quaternion = (np.asarray(values[part], np.float64) for part in ("position", "quaternion"))
        if position.shape[-1:] != (3,) or quaternion.shape[-1:] != (4,):
            problem = f"position {position.shape} and quaternion {quaternion.shape}; expected (3,) and (4,)"
            raise damaged(self._row, name, problem)
        wrong = bad_pose(position.reshape(-1, 3), quaternion.reshape(-1, 4))
        if wrong is not None:
            raise damaged(self._row, name, wrong[1], wrong[0] if position.ndim > 1 else None)
        return rigid_transform(position, quaternion) if position.ndim == 1 else Poses(position, quaternion)

    def __repr__(self) -> str:
        return f"{type(self).__name__}(id={self.id!r}, label={self.label}, {self.touch_count} touches)"

    def _repr_html_(self) -> str:
        """Show the touches as a grid of pictures in a notebook."""
        from realtouch.pictures import round_html

        return round_html(self)


class TouchSingleRound(TouchRound):
    """T touches of one object, one image each."""

    __slots__ = ()

    @property
    def gel_pose_cell_frame(self) -> Poses:
        """Pose of the gel at contact, T poses; their arrays are views."""
        return self._once("gel_pose_cell_frame", lambda: poses(self._row))

    @property
    def sensor_image(self) -> SensorImages:
        """Images, T of them, decoded on demand: int -> (H, W, 3) uint8, else (n, H, W, 3)."""
        return self._once("sensor_image", lambda: _images(self._row))


class TouchSeqRound(TouchRound):
    """T touches of one object, one clip each; touch i has N_i frames."""

    __slots__ = ()

    @property
    def video_length_frames(self) -> NDArray[np.int64]:
        """Number of frames of each clip, shape (T,), int64."""
        lengths = clip_lengths(self._row)
        if lengths is None:
            raise missing_column(self._row, "video_length_frames")
        return lengths

    @property
    def gel_pose_cell_frame_seq(self) -> PoseSequences:
        """Pose of the gel in each frame: T sequences of N_i poses; their arrays are views."""
        return self._once("gel_pose_cell_frame_seq", lambda: pose_sequences(self._row))

    @property
    def time_stamp_rel_seq(self) -> tuple[NDArray[np.timedelta64], ...]:
        """Time stamp of each frame: T arrays of ``timedelta64``, shapes (N_i,)."""
        return self._once("time_stamp_rel_seq", lambda: frame_times(self._row))

    @property
    def touch_start_time_rel(self) -> NDArray[np.timedelta64]:
        """Time of first registered contact, shape (T,), ``timedelta64``."""
        return touch_durations(self._row, "touch_start_time_rel")

    @property
    def touch_end_time_rel(self) -> NDArray[np.timedelta64]:
        """Time of last registered contact, shape (T,), ``timedelta64``."""
        return touch_durations(self._row, "touch_end_time_rel")

    @property
    def sensor_video(self) -> SensorClips:
        """Clips, T of them, opened on demand."""
        return self._once("sensor_video", lambda: SensorClips(self._row))

    def contact_frames(
        self, method: str = "contact_end", *, threads: int | None = None, out: Pixels | None = None
    ) -> Pixels:
        """Decode the frame of each touch that shows the contact.

        Parameters
        ----------
        method : str
            See :meth:`realtouch.TouchClip.contact_index`.
        threads : int, optional
            How many clips to look into at a time; as many as there are processor cores, up to 4, by default.
        out : ndarray, shape (T, H, W, 3), uint8, optional
            Where to put them.

        Returns
        -------
        ndarray, shape (T, H, W, 3), uint8
        """
        clips, chosen = self.sensor_video, require_method(method)
        pixels = clips.room(len(clips)) if out is None else out
        if chosen == "median":
            # Chosen by the pictures: each clip is decoded whole.
            in_parallel(
                lambda touch: clips[touch].contact_into(pixels[touch], chosen), len(clips), _cores(threads)
            )
        else:
            frames = contact_frames_of(clips, chosen)
            decode_frames(clips, range(len(clips)), frames, pixels, _cores(threads))
        return pixels

    def contact_windows(
        self, touches: Any = slice(None), *, threads: int | None = None
    ) -> tuple[Pixels, ...]:
        """Decode every frame of contact of several touches.

        Parameters
        ----------
        touches : slice, sequence of int, or boolean mask
            Which touches; all by default, which at 320x240 takes 1.6 MB for each of them.
        threads : int, optional
            How many frames to decode at a time; as many as there are processor cores, up to 4, by default.

        Returns
        -------
        tuple of ndarray, shapes (n_i, H, W, 3), uint8
            The frames of :attr:`realtouch.TouchClip.contact_window` of each touch; views of one array.
        """
        clips = self.sensor_video
        wanted = np.asarray(positions_of(touches, len(clips)), np.int64)
        starts, stops = (ends[wanted] for ends in contact_windows_of(clips))
        counts = stops - starts
        ends = np.cumsum(counts)
        pixels = clips.room(int(counts.sum()))
        frames = np.arange(len(pixels)) + np.repeat(starts - (ends - counts), counts)
        owners = np.repeat(wanted, counts)
        decode_frames(clips, owners.tolist(), frames.tolist(), pixels, _cores(threads))
        return tuple(np.split(pixels, ends[:-1])) if len(wanted) else ()


def _cores(threads: int | None) -> int:
    return threads or min(os.cpu_count() or 1, _MOST_THREADS)


def _images(row: Row) -> SensorImages:
    media_count(row, "sensor_image")
    return SensorImages(row)
