"""LeRobotDatasets v2.0, v2.1 and v3.0 as recordings: an episode is a sequence of pictures of one camera.

Facts of the format: ``meta/info.json`` says what the features are and where files lie. Frames are rows of
Parquet: of one episode a file (v2), or of many (v3). Pictures are in these rows (dtype ``image``) or in video
(dtype ``video``), where v3 states at how many seconds an episode begins.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from itertools import groupby
from operator import attrgetter

import numpy as np

from realtouch import video
from realtouch.exchange.episodes import ACTION, STATE, TIME
from realtouch.exchange.foreign_parquet import ForeignParquet, is_picture, stored_pictures
from realtouch.exchange.found_touches import FoundTouch
from realtouch.exchange.lerobot_metadata import (
    Episode,
    Info,
    Mark,
    read_episodes,
    read_info,
    read_tasks,
)
from realtouch.exchange.recordings import Recording
from realtouch.touch_options import POSE_COLUMNS, POSITION_COLUMNS, ImportColumns
from tactile_toolkit import store
from tactile_toolkit.array_types import AnyArray, Float64
from tactile_toolkit.errors import IntegrityError, ItemError

_INDICES = ("index", "frame_index", "episode_index", "task_index", "timestamp")
_ROWS = ".parquet"


def find_lerobot(home: store.DataFolder, columns: ImportColumns, table: str | None) -> Iterator[Recording]:
    """Yield each episode, with the pictures of the only camera or of that named; InputError for several.

    An episode that cannot be used is a recording with a problem.
    """
    info = read_info(home)
    camera = info.camera(columns.image_name, home.address())
    reader = _Episodes(home, info, camera, read_tasks(home, info))
    yield from map(reader.recording, read_episodes(home, info, camera))


def describe_conversion(items: Sequence[FoundTouch]) -> str:
    """Return what was done to the pictures, and which cameras were left out; empty for nothing."""
    first = next((item for item in items if item.problem is None), items[0])
    home, words = store.open_folder(first.home), []
    if first.problem is None and not first.path.endswith(_ROWS):
        words.append(video.open_video(home, first.path).conversion)
    cameras = [name for name, each in read_info(home).features.items() if each.is_camera]
    words += [f"{name!r} was left out" for name in cameras if name != first.part]
    return ", ".join(filter(None, words))


def encoded_frames(items: Iterable[FoundTouch]) -> Iterator[bytes | ItemError]:
    """Yield the pictures of items in order, from rows or videos."""
    for (home, path), group in groupby(items, key=attrgetter("file")):
        if path.endswith(_ROWS):
            yield from stored_pictures(group)
            continue
        numbers = [item.start + frame for item in group for frame in range(max(1, item.frames))]
        for rising in np.split(numbers, np.flatnonzero(np.diff(numbers) <= 0) + 1):
            yield from _of_video(store.open_folder(home), path, rising.tolist())


def _of_video(home: store.DataFolder, path: str, numbers: Sequence[int]) -> Iterator[bytes | ItemError]:
    try:
        yield from video.encoded_pictures(home, path, numbers)
    except ItemError as error:
        yield from (error for _ in numbers)


class _Episodes:
    """Reads the episodes of one camera; the columns of the file read last are kept."""

    def __init__(self, home: store.DataFolder, info: Info, camera: str, tasks: Mapping[int, str]) -> None:
        self.home = home
        self.info = info
        self.camera = camera
        self.tasks = tasks
        self._path = ""
        self._columns: dict[str, AnyArray] = {}
        self._picture_bytes = 0

    def recording(self, episode: Episode) -> Recording:
        """Return an episode; one that cannot be used has a problem, and one picture."""
        try:
            return self._recording(episode)
        except ItemError as error:
            problem = error
        except IntegrityError as error:
            problem = ItemError("file", error.what)
        address = self.home.address()
        return Recording(episode.name, address, episode.data_path, self.camera, 0, 1, 0, problem=problem)

    def _recording(self, episode: Episode) -> Recording:
        self._read(episode.data_path)
        rows = _rows_of(episode, self._columns)
        per_frame = {name: column[rows] for name, column in self._columns.items()}
        time_s = _times(per_frame, self.info.fps)
        path, first, size = episode.data_path, rows.start, self._picture_bytes
        if self.info.features[self.camera].dtype == "video":
            path = episode.video_path
            store.size_inside(self.home, path)
            found = video.open_video(self.home, path)
            first = _first_picture(found.time_s, episode.video_start_s + time_s, self.info.fps)
            size = found.picture_bytes
        values = dict(episode.values)
        if self.info.realtouch is None:
            values |= self._task(per_frame)
        else:
            time_s = per_frame.pop(TIME, time_s)
            _name_ours(values, per_frame, self.info.realtouch)
        for name in _INDICES:
            per_frame.pop(name, None)
        address, count = self.home.address(), len(time_s)
        return Recording(
            episode.name, address, path, self.camera, first, count, size, values, per_frame, time_s
        )

    def _read(self, path: str) -> None:
        """Read all columns of a file but pictures, unless it was read last."""
        if path == self._path:
            return
        parquet, features = ForeignParquet(self.home, path), self.info.features
        if features[self.camera].dtype == "image":
            if not is_picture(parquet.types.get(self.camera)):
                raise ItemError("image", f"{path!r} has no column of pictures {self.camera!r}")
            self._picture_bytes = parquet.picture_bytes(self.camera)
        cameras = {name for name, each in features.items() if each.is_camera}
        names = [name for name, kind in parquet.types.items() if name not in cameras and not is_picture(kind)]
        self._columns = parquet.arrays(names)
        self._path = path

    def _task(self, per_frame: dict[str, AnyArray]) -> dict[str, str]:
        """Return the task of an episode; if there are several, each frame gets its own."""
        numbers = per_frame.get("task_index")
        if numbers is None or numbers.ndim > 1:
            return {}
        found = [self.tasks.get(number) for number in numbers.tolist()]
        if len({*found}) > 1:
            per_frame["task"] = np.array(found, object)
        elif found[0] is not None:
            return {"task": found[0]}
        return {}


def _rows_of(episode: Episode, columns: Mapping[str, AnyArray]) -> slice:
    """Return where the frames of an episode stand in a file; ItemError unless all do, one after another."""
    numbers = columns.get("episode_index", np.empty(0))
    if numbers.dtype.kind not in "iu" or numbers.ndim > 1 or (numbers[1:] < numbers[:-1]).any():
        raise ItemError("episode", f"{episode.data_path!r} has no column 'episode_index' of rising integers")
    start, stop = np.searchsorted(numbers, [episode.number, episode.number + 1]).tolist()
    if stop - start != episode.length or not episode.length:
        found = f"{episode.data_path!r} holds {stop - start:,} frames of it"
        raise ItemError("episode", f"{found}; expected {episode.length:,}, as stated, and at least one")
    return slice(start, stop)


def _times(per_frame: Mapping[str, AnyArray], fps: float) -> Float64:
    """Return the times of frames, seconds: as stated, or by the frame rate if they are that, rounded."""
    stated = per_frame.get("timestamp", np.empty(0, object))
    if (
        stated.dtype.kind != "f"
        or stated.ndim > 1
        or not np.isfinite(stated).all()
        or (np.diff(stated) < 0).any()
    ):
        raise ItemError("time", f"the column 'timestamp' is {stated.dtype}; expected seconds that rise")
    exact: Float64 = np.arange(len(stated)) / fps
    if np.array_equal(exact.astype(stated.dtype), stated):
        return exact
    return stated.astype(np.float64)


def _first_picture(shown_s: Float64, wanted_s: Float64, fps: float) -> int:
    """Return which picture of a video is shown at the first time, if the next are shown at the others."""
    first = int(np.abs(shown_s - wanted_s[0]).argmin())
    found = shown_s[first : first + len(wanted_s)]
    if len(found) < len(wanted_s) or np.abs(found - wanted_s).max() * fps > 0.5:
        raise ItemError(
            "video",
            f"the {len(shown_s):,} pictures of its video, until {shown_s[-1]:.3f} s, are not shown at the "
            f"times of its {len(wanted_s):,} frames, from {wanted_s[0]:.3f} s to {wanted_s[-1]:.3f} s",
        )
    return first


def _name_ours(values: dict[str, object], per_frame: dict[str, AnyArray], mark: Mark) -> None:
    """Give what this toolkit wrote the names that it has in its tables."""
    values.pop("touch", None)
    for column, names in ((STATE, POSE_COLUMNS), (ACTION, POSITION_COLUMNS)):
        if column in per_frame:
            per_frame |= dict(zip(names, np.atleast_2d(per_frame.pop(column)).T, strict=False))
    of_episode = ["label", "object_id", *(POSITION_COLUMNS if mark.clips else ())]
    for feature, stored in mark.extra.items():
        prefix, _, name = stored.partition(".")
        if feature in per_frame:
            per_frame[name] = per_frame.pop(feature)
            of_episode += [name] * (mark.clips and prefix == "extra")
    for name in of_episode:
        if name in per_frame:
            values[name] = per_frame.pop(name)[0].tolist()
    label = values.get("label")
    if isinstance(label, int) and 0 <= label < len(mark.class_names):
        values["label_name"] = mark.class_names[label]
