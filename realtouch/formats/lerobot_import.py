"""LeRobotDatasets v2.0, v2.1 and v3.0 as recordings: an episode is a sequence of pictures of one camera.

Facts of the format: ``meta/info.json`` says what the features are and where files lie. Frames are rows of
Parquet; a file holds one episode (v2) or many (v3). Pictures are in these rows (dtype ``image``) or in videos
(dtype ``video``). In v3 a video holds many episodes, and metadata state the time at which each begins.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from functools import partial

import numpy as np
import pyarrow as pa

from realtouch import importing, touch_options
from realtouch.formats import episodes, flat_parquet, lerobot_metadata, media_files, zarr_recordings
from realtouch.touches.rounds import touch_id
from realtouch.video import videos
from tactile_toolkit import errors, store, wording
from tactile_toolkit.array_types import Float64
from tactile_toolkit.columns import column_types

_ROWS = ".parquet"
_INDICES = ("index", "frame_index", "episode_index", "task_index", "timestamp")
_VECTORS = {episodes.STATE: touch_options.POSE_COLUMNS, episodes.ACTION: touch_options.POSITION_COLUMNS}
_OF_EPISODE = ("label", "label_name", "object_id")


def find_lerobot(
    home: store.DataFolder, columns: importing.ImportColumns, table: str | None
) -> Iterator[importing.Recording]:
    """Yield each episode with the pictures of the named or the only camera; InputError for several.

    An episode that cannot be used is a recording with a problem.
    """
    info = lerobot_metadata.read_info(home)
    camera = info.camera(columns.image_name, home.address())
    reader = _Episodes(home, info, camera, lerobot_metadata.read_tasks(home, info))
    yield from map(reader.recording, lerobot_metadata.read_episodes(home, info, camera))


def describe_conversion(touches: importing.FoundTouches) -> str:
    """Return how pictures are converted; empty if they are stored as they are."""
    places = touches.take(np.flatnonzero(touches.is_usable)[:1])
    if not len(places) or places[0].path.endswith(_ROWS):
        return ""
    usable = places[0]
    return videos.open_video(store.open_folder(usable.home), usable.path).conversion


def _read_frames(
    home: store.DataFolder, place: importing.PicturePlace, numbers: Sequence[int]
) -> Iterator[bytes | errors.ItemError]:
    """Yield the pictures with some numbers of a Parquet file or video."""
    if place.path.endswith(_ROWS):
        return flat_parquet.read_rows(home, place, numbers)
    return media_files.read_frames(home, place, numbers)


read_contents = partial(importing.pictures_by_file, _read_frames)


class _Episodes:
    """Reads the episodes of one camera; the columns of the last file are kept."""

    def __init__(
        self, home: store.DataFolder, info: lerobot_metadata.Info, camera: str, tasks: Mapping[int, str]
    ) -> None:
        self.home = home
        self.info = info
        self.camera = camera
        self.tasks = tasks
        self._path = ""
        self._columns: dict[str, pa.Array] = {}
        self._picture_bytes = 0

    def recording(self, episode: lerobot_metadata.Episode) -> importing.Recording:
        """Return the recording of an episode; if it cannot be used, it has a problem and one picture."""
        others = tuple(name for name in self.info.pictures if name != self.camera)
        place = self.home.address(), episode.data_path, self.camera
        found = importing.Recording(episode.name, *place, 0, 1, 0, episode.values, left_out=others)
        try:
            found = self._read(found, episode)
        except (errors.ItemError, errors.IntegrityError) as error:
            return replace(found, problem=errors.ItemError(getattr(error, "reason", "file"), error.what))
        return found if self.info.realtouch is None else _as_ours(found, self.info.realtouch)

    def _read(self, found: importing.Recording, episode: lerobot_metadata.Episode) -> importing.Recording:
        self._read_columns(episode.data_path)
        rows = _rows_of(episode, self._columns)
        per_frame = {
            name: column.slice(rows.start, rows.stop - rows.start) for name, column in self._columns.items()
        }
        time_s = _times(per_frame, self.info.fps)
        values = {**self._task(per_frame), **episode.values}
        per_frame = {name: column for name, column in per_frame.items() if name not in _INDICES}
        found = replace(found, frames=len(time_s), values=values, per_frame=per_frame, time_s=time_s)
        if self.info.features[self.camera].dtype == "image":
            return replace(found, first=rows.start, frame_bytes=self._picture_bytes)
        self.home.size_inside(episode.video_path)
        opened = videos.open_video(self.home, episode.video_path)
        first = _first_picture(opened.time_s, episode.video_start_s + time_s, self.info.fps)
        return replace(found, path=episode.video_path, first=first, frame_bytes=opened.picture_bytes)

    def _read_columns(self, path: str) -> None:
        """Read all columns of a file except pictures, unless it was the last one that was read."""
        if path == self._path:
            return
        parquet = flat_parquet.ForeignParquet(self.home, path)
        if self.info.features[self.camera].dtype == "image":
            if not flat_parquet.is_picture(parquet.types.get(self.camera)):
                raise errors.ItemError("image", f"{path!r} has no column of pictures {self.camera!r}")
            self._picture_bytes = parquet.picture_bytes(self.camera)
        plain = [name for name, data_type in parquet.types.items() if not flat_parquet.is_picture(data_type)]
        columns = parquet.columns([name for name in plain if name not in self.info.pictures])
        for name, column in columns.items():
            lengths = column_types.lengths_of(column)
            if len(lengths) > 1:
                raise errors.ItemError(
                    "column",
                    f"the column {name!r} has vectors of {lengths[0]} and of {lengths[-1]} values; "
                    "expected one length",
                )
        self._columns = columns
        self._path = path

    def _task(self, per_frame: dict[str, pa.Array]) -> dict[str, str]:
        """Return the task of an episode; if there are several, each frame gets its own."""
        numbers = per_frame.get("task_index", pa.nulls(0))
        if not pa.types.is_integer(numbers.type):
            return {}
        found = [self.tasks.get(number) for number in numbers.to_pylist()]
        if len({*found}) > 1:
            per_frame["task"] = pa.array(found, pa.string())
        elif found[0] is not None:
            return {"task": found[0]}
        return {}


def _rows_of(episode: lerobot_metadata.Episode, columns: Mapping[str, pa.Array]) -> slice:
    """Return the rows of the frames of an episode in a file; ItemError unless all are there, in sequence."""
    stated = columns.get("episode_index", pa.nulls(0))
    numbers = np.empty(0, np.int64)
    is_stated = pa.types.is_integer(stated.type) and not stated.null_count
    if is_stated:
        numbers = stated.to_numpy()
    if not is_stated or (numbers[1:] < numbers[:-1]).any():
        raise errors.ItemError(
            "episode", f"{episode.data_path!r} has no column 'episode_index' of rising integers"
        )
    start, stop = np.searchsorted(numbers, [episode.number, episode.number + 1]).tolist()
    if stop - start != episode.length or not episode.length:
        raise errors.ItemError(
            "episode",
            f"{episode.data_path!r} holds {stop - start:,} frames of this episode; "
            f"expected {episode.length:,}, as stated, and at least one",
        )
    return slice(start, stop)


def _times(per_frame: Mapping[str, pa.Array], fps: float) -> Float64:
    """Return the times of frames, seconds: as stated, or by the frame rate if these agree as float32."""
    column = per_frame.get("timestamp", pa.nulls(0))
    stated: Float64 = np.full(1, np.nan)
    if pa.types.is_floating(column.type):
        stated = column.to_numpy(zero_copy_only=False)
    if not np.isfinite(stated).all():
        raise errors.ItemError("time", f"the column 'timestamp' is {column.type}; expected seconds as floats")
    exact: Float64 = np.arange(len(stated)) / fps
    is_rounded = np.array_equal(exact.astype(np.float32), stated)
    return exact if is_rounded else stated


def _first_picture(shown_s: Float64, wanted_s: Float64, fps: float) -> int:
    """Return the number of the picture of a video at the first time.

    Raises ItemError unless the video shows the pictures after it at the other times.
    """
    first = int(np.abs(shown_s - wanted_s[0]).argmin())
    found = shown_s[first : first + len(wanted_s)]
    if len(found) < len(wanted_s) or np.abs(found - wanted_s).max() * fps > 0.5:
        raise errors.ItemError(
            "video",
            f"the video shows its {wording.with_count(len(shown_s), 'pictures')} until {shown_s[-1]:.3f} s, "
            f"not at the times of the frames, until {wanted_s[-1]:.3f} s",
        )
    return first


def _as_ours(found: importing.Recording, mark: lerobot_metadata.Mark) -> importing.Recording:
    """Return an episode that this toolkit wrote, with its columns named as in its tables."""
    every = found.per_frame
    columns = {name: column for name, column in every.items() if name not in mark.extra}
    values = dict(found.values)
    time_s = found.time_s
    if episodes.TIME in columns:
        time_s = columns.pop(episodes.TIME).to_numpy(zero_copy_only=False)
    values.pop("task", None)  # it is the label
    name = round_id = str(values.pop("round_id", found.name))
    touch = values.pop("touch", None)
    of_episode = list(_OF_EPISODE)
    cut = "frames"
    if mark.clips:
        name = found.name
        cut = "whole"
        if isinstance(touch, int):
            name = touch_id(round_id, touch)
        of_episode += [*touch_options.POSITION_COLUMNS, *mark.per_touch]
    found = replace(found, name=name, round=round_id, cut=cut, time_s=time_s, per_frame=columns)
    found = zarr_recordings.with_contact(found)
    ours = zarr_recordings.name_ours(found, _VECTORS, mark.class_names).per_frame
    # Further columns are added last: one may have the name of a column of ours, which is kept then.
    per_frame = {**{mark.own_name(name): every[name] for name in mark.extra if name in every}, **ours}
    values |= {each: per_frame.pop(each)[0].as_py() for each in of_episode if each in per_frame}
    return replace(found, values=values, per_frame=per_frame)
