"""LeRobotDatasets v2.0, v2.1 and v3.0 as recordings: an episode is a sequence of pictures of one camera.

Facts of the format: ``meta/info.json`` says what the features are and where files lie. Frames are rows of
Parquet; a file holds one episode (v2) or many (v3). Pictures are in these rows (dtype ``image``) or in videos
(dtype ``video``). In v3 a video holds many episodes, and metadata state the time at which each begins.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from functools import lru_cache, partial
from typing import Annotated

import msgspec
import numpy as np
import pyarrow as pa

from realtouch.formats import flat_parquet, media_files, zarr_recordings
from realtouch.importing import import_options, source_files, source_touches
from realtouch.touches.rounds import touch_id
from realtouch.video import videos
from tactile_toolkit import errors, store, wording
from tactile_toolkit.columns import column_types, tables
from tactile_toolkit.value_types import Float64, JsonObject

_ROWS = ".parquet"
_INDICES = ("index", "frame_index", "episode_index", "task_index", "timestamp")
_INFO = "meta/info.json"
_FOLDERS = ("meta", "data", "videos", "images")
_PICTURES = ("image", "video")
_DEPTH = ("is_depth_map", "video.is_depth_map")
_MAX_BYTES = 256 << 20
_READABLE_VERSION = re.compile(r"v(2\.[01]|3\.0)")
_FIELD = re.compile(r"\{(\w+)(?::0?([0-9])d)?\}")
_RANGE = re.compile(r"(\d{1,15}):(\d{1,15})")

# Fields of episodes that locate their files, or that follow from their frames.
_OF_FILES = re.compile(r"(stats|data|meta|videos)/.*|dataset_(from|to)_index|tasks|length|episode_index")
_Count = Annotated[int, msgspec.Meta(ge=0, lt=1 << 50)]


def find_lerobot(
    home: store.DataFolder,
    columns: import_options.ImportColumns,
    table: str | None,
    ledger: source_files.Ledger,
) -> Iterator[source_touches.Recording]:
    """Yield each episode with the pictures of the named or the only camera; InputError for several.

    An episode that cannot be used is a recording with a problem.
    """
    for folder in _FOLDERS:
        ledger.use(home, folder)
    info = read_info(home)
    camera = info.camera(columns.image_name, home.address())
    reader = _Episodes(home, info, camera, read_tasks(home, info))
    yield from map(reader.recording, read_episodes(home, info, camera))


def _read_frames(
    home: store.DataFolder, picture: source_touches.PictureLocation, numbers: Sequence[int]
) -> Iterator[bytes | errors.ItemError]:
    """Yield the pictures with some numbers of a Parquet file or video."""
    if picture.path.endswith(_ROWS):
        return flat_parquet.read_rows(home, picture, numbers)
    return media_files.read_frames(home, picture, numbers)


read_contents = partial(source_files.pictures_by_file, _read_frames)


class _Episodes:
    """Reads the episodes of one camera; the columns of the last file are cached."""

    def __init__(self, home: store.DataFolder, info: Info, camera: str, tasks: Mapping[int, str]) -> None:
        self.home = home
        self.info = info
        self.camera = camera
        self.tasks = tasks
        self._columns_of = lru_cache(1)(self._read_columns)

    def recording(self, episode: Episode) -> source_touches.Recording:
        """Return the recording of an episode; if it cannot be used, it has a problem and one picture."""
        others = tuple(name for name in self.info.pictures if name != self.camera)
        source = self.home.address(), episode.data_path, self.camera
        recording = source_touches.Recording(episode.name, *source, 0, 1, 0, episode.values, left_out=others)
        try:
            recording = self._read(recording, episode)
        except (errors.ItemError, errors.IntegrityError) as error:
            return replace(recording, problem=errors.ItemError(getattr(error, "reason", "file"), error.what))
        return recording if self.info.realtouch is None else _as_ours(recording, self.info.realtouch)

    def _read(self, recording: source_touches.Recording, episode: Episode) -> source_touches.Recording:
        columns, picture_bytes = self._columns_of(episode.data_path)
        rows = _rows_of(episode, columns)
        per_frame = {
            name: column.slice(rows.start, rows.stop - rows.start) for name, column in columns.items()
        }
        time_s = _times(per_frame, self.info.fps)
        values = {**self._task(per_frame), **episode.values}
        per_frame = {name: column for name, column in per_frame.items() if name not in _INDICES}
        recording = replace(recording, frames=len(time_s), values=values, per_frame=per_frame, time_s=time_s)
        if self.info.features[self.camera].dtype == "image":
            return replace(recording, first=rows.start, frame_bytes=picture_bytes)
        self.home.size_inside(episode.video_path)
        opened = videos.open_video(self.home, episode.video_path)
        first = _first_picture(opened.time_s, episode.video_start_s + time_s, self.info.fps)
        return replace(
            recording,
            path=episode.video_path,
            first=first,
            frame_bytes=opened.picture_bytes,
            conversions=(opened.conversion, opened.conversion),
        )

    def _read_columns(self, path: str) -> tuple[dict[str, pa.Array], int]:
        """Return all columns of a file except pictures, and the approximate size of a picture in it."""
        picture_bytes = 0
        parquet = flat_parquet.ForeignParquet(self.home, path)
        if self.info.features[self.camera].dtype == "image":
            if not flat_parquet.is_picture(parquet.types.get(self.camera)):
                raise errors.ItemError("image", f"{path!r} has no column of pictures {self.camera!r}")
            picture_bytes = parquet.picture_bytes(self.camera)
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
        return columns, picture_bytes

    def _task(self, per_frame: dict[str, pa.Array]) -> dict[str, str]:
        """Return the task of an episode; if there are several, each frame gets its own."""
        numbers = per_frame.get("task_index", pa.nulls(0))
        if not pa.types.is_integer(numbers.type):
            return {}
        tasks = [self.tasks.get(number) for number in numbers.to_pylist()]
        if len({*tasks}) > 1:
            per_frame["task"] = pa.array(tasks, pa.string())
        elif tasks[0] is not None:
            return {"task": tasks[0]}
        return {}


def _rows_of(episode: Episode, columns: Mapping[str, pa.Array]) -> slice:
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
    stated_s = shown_s[first : first + len(wanted_s)]
    if len(stated_s) < len(wanted_s) or np.abs(stated_s - wanted_s).max() * fps > 0.5:
        raise errors.ItemError(
            "video",
            f"the video shows its {wording.with_count(len(shown_s), 'pictures')} until {shown_s[-1]:.3f} s, "
            f"not at the times of the frames, until {wanted_s[-1]:.3f} s",
        )
    return first


def _as_ours(recording: source_touches.Recording, mark: Mark) -> source_touches.Recording:
    """Return an episode that this toolkit wrote, with its columns named as in its tables."""
    values = dict(recording.values)
    values.pop("task", None)  # it is the label
    name = round_id = str(values.pop("round_id", recording.name))
    touch = values.pop("touch", None)
    if mark.clips:
        name = touch_id(round_id, touch) if isinstance(touch, int) else recording.name
    every = recording.per_frame
    own = {own_name: every[feature] for feature, own_name in mark.columns.items() if feature in every}
    # What another program added keeps its name.
    per_frame = {feature: column for feature, column in every.items() if feature not in mark.columns} | own
    whole = replace(recording, values=values, per_frame=per_frame)
    ends = np.array([recording.frames])
    (episode,) = zarr_recordings.our_episodes(whole, ends, [name], mark.class_names, mark.columns_of_clips)
    time_s = recording.time_s if episode.time_s is None else episode.time_s
    return replace(episode, round=round_id, cut="whole" if mark.clips else "frames", time_s=time_s)


class Mark(msgspec.Struct, frozen=True):
    """Mark of an export of this toolkit.

    ``clips``: an episode is a clip, not a round. ``columns``: the name in the data set of each feature;
    ``columns_of_clips``: those with an entry for each touch.
    """

    class_names: tuple[str, ...]
    clips: bool
    columns: Mapping[str, str]
    columns_of_clips: tuple[str, ...]


class Feature(msgspec.Struct, frozen=True):
    """A feature of frames: the type of its values, and details of pictures."""

    dtype: str
    info: JsonObject | None = None

    @property
    def is_depth(self) -> bool:
        """Whether it holds depth maps."""
        return any((self.info or {}).get(key) for key in _DEPTH)


class Info(msgspec.Struct, frozen=True):
    """The content of ``meta/info.json``; ``realtouch`` is the mark of exports of this toolkit."""

    codebase_version: str
    fps: Annotated[float, msgspec.Meta(gt=0, lt=1e6)]
    features: Mapping[str, Feature]
    data_path: str
    video_path: str | None = None
    chunks_size: Annotated[int, msgspec.Meta(gt=0, lt=1 << 50)] = 1000
    splits: Mapping[str, str] | None = None
    realtouch: Mark | None = None

    @property
    def pictures(self) -> list[str]:
        """Names of the features that are pictures: colour images or depth maps."""
        return [name for name, feature in self.features.items() if feature.dtype in _PICTURES]

    @property
    def is_v2(self) -> bool:
        """Whether each episode has a file of its own, as in version 2."""
        return self.codebase_version.startswith("v2")

    def camera(self, name: str, source: str) -> str:
        """Return the feature of the pictures to import: the named one, or the only one that is not depth.

        Raises InputError if there is no such feature, or if there are several.
        """
        cameras = [key for key in self.pictures if not self.features[key].is_depth]
        return source_files.chosen_pictures(cameras, name, source, "cameras", self.features)

    def split_of(self, episode: int) -> dict[str, object]:
        """Return the split of an episode as a field; empty if it is not stated."""
        for name, text in (self.splits or {}).items():
            ends = _RANGE.fullmatch(text)
            if ends and int(ends[1]) <= episode < int(ends[2]):
                return {"split": name}
        return {}


@dataclass(frozen=True)
class Episode:
    """An episode: the files and number of its frames, and its other fields."""

    number: int
    length: int
    data_path: str
    video_path: str
    video_start_s: float
    values: Mapping[str, object]

    @property
    def name(self) -> str:
        """Name of the episode and of its round."""
        return f"episode_{self.number:06d}"


class _Files(msgspec.Struct, frozen=True):
    """Numbers of the file of an episode in version 3, and where the episode begins in a video, seconds."""

    chunk_index: _Count = 0
    file_index: _Count = 0
    from_timestamp: Annotated[float, msgspec.Meta(ge=0, lt=1e9)] = 0.0


def read_info(home: store.DataFolder) -> Info:
    """Read the description of a data set; InputError for an unknown version, or if it cannot be read."""
    with _as_input_error(home, _INFO):
        info = msgspec.json.decode(_content(home, _INFO), type=Info)
    if not _READABLE_VERSION.fullmatch(info.codebase_version):
        raise errors.InputError(
            f"{home.address(_INFO)!r} states version {wording.shortened(info.codebase_version, 80)!r}; "
            "expected v2.0, v2.1 or v3.0",
            next="convert it with the tools of LeRobot",
        )
    return info


def read_tasks(home: store.DataFolder, info: Info) -> dict[int, str]:
    """Return the text of each task by its number; InputError if the file cannot be read."""
    path = "meta/tasks.jsonl" if info.is_v2 else "meta/tasks.parquet"
    tasks: dict[int, str] = {}
    if not home.exists(path):
        return tasks
    for line in _lines(home, path):
        number = line.get("task_index")
        texts = [value for value in line.values() if isinstance(value, str)]
        if not isinstance(number, int) or len(texts) != 1:
            raise errors.InputError(
                f"{home.address(path)!r}: {wording.shortened(str(line), 80)}; expected a number and a text"
            )
        tasks[number] = texts[0]
    return tasks


def read_episodes(home: store.DataFolder, info: Info, camera: str) -> Iterator[Episode]:
    """Yield the episodes in the order of their numbers; InputError if their metadata cannot be read."""
    paths = ["meta/episodes.jsonl"]
    if not info.is_v2:
        paths = sorted(path for path in home.walk("meta/episodes") if path.endswith(".parquet"))
    last = -1
    for path in paths:
        for line in _lines(home, path):
            with _as_input_error(home, path):
                episode = _episode(info, camera, line)
            if episode.number <= last:
                raise errors.InputError(
                    f"{home.address(path)!r} holds episode {episode.number:,} after {last:,}; "
                    "expected numbers that rise"
                )
            last = episode.number
            yield episode


def _episode(info: Info, camera: str, line: JsonObject) -> Episode:
    number, length = (msgspec.convert(line.get(name), _Count) for name in ("episode_index", "length"))
    rows, video = (_files(line, f"{folder}/") for folder in ("data", f"videos/{camera}"))

    def path(template: str, files: _Files) -> str:
        numbers = {"chunk_index": files.chunk_index, "file_index": files.file_index}
        chunk = number // info.chunks_size
        values = {**numbers, "episode_chunk": chunk, "episode_index": number, "video_key": camera}
        return _filled(template, values)

    others = {name: value for name, value in line.items() if not _OF_FILES.fullmatch(name)}
    paths = path(info.data_path, rows), path(info.video_path or "", video)
    return Episode(number, length, *paths, video.from_timestamp, {**info.split_of(number), **others})


def _files(line: JsonObject, prefix: str) -> _Files:
    fields = {name.removeprefix(prefix): value for name, value in line.items() if name.startswith(prefix)}
    return msgspec.convert(fields, _Files)


def _filled(template: str, values: Mapping[str, object]) -> str:
    # `str.format` would look up attributes, and allocate as much memory as a template asks for.
    return _FIELD.sub(lambda field: str(values.get(field[1], field[0])).zfill(int(field[2] or 0)), template)


def _lines(home: store.DataFolder, path: str) -> Iterator[JsonObject]:
    """Yield the rows of a JSON Lines or Parquet file; columns of statistics are left out."""
    with _as_input_error(home, path):
        if path.endswith(".jsonl"):
            yield from msgspec.json.Decoder(JsonObject).decode_lines(_content(home, path))
            return
        parquet = flat_parquet.ForeignParquet(home, path)
        yield from parquet.rows([name for name in parquet.types if not name.startswith("stats/")])


def _content(home: store.DataFolder, path: str) -> bytes:
    with tables.open_source(home, path) as stream:
        content = stream.read(_MAX_BYTES + 1)
    if len(content) > _MAX_BYTES:
        raise errors.InputError(f"{home.address(path)!r} is larger than the limit of {_MAX_BYTES:,} bytes")
    return content


@contextmanager
def _as_input_error(home: store.DataFolder, path: str) -> Iterator[None]:
    """Raise an InputError that names the file for metadata that cannot be used."""
    try:
        yield
    except errors.ItemError as error:
        raise errors.InputError(f"{home.address(path)!r}: {error.what}") from error
    except (msgspec.MsgspecError, UnicodeError, RecursionError, ArithmeticError) as error:
        raise errors.InputError(
            f"{home.address(path)!r} holds no metadata of a LeRobotDataset ({error})"
        ) from error
