"""The folder ``meta`` of a LeRobotDataset, read and written: features, episodes, tasks and statistics.

An export of this toolkit has a mark in ``info.json``, by which an import restores the names of its columns.
"""

from __future__ import annotations

import json
import re
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Annotated

import msgspec
import pyarrow as pa

from realtouch import convert, importing
from realtouch.formats import flat_parquet, lerobot_statistics
from realtouch.formats.episodes import ACTION, DEPTH, STATE, Episodes
from tactile_toolkit import errors, read, store, touch
from tactile_toolkit.json_types import JsonObject

_INFO = "meta/info.json"
_PICTURES = ("image", "video")
_DEPTH_INFO = {"is_depth_map": True, "depth_unit": "m"}
_DEPTH = ("is_depth_map", "video.is_depth_map")
_MAX_BYTES = 256 << 20
_READABLE_VERSION = re.compile(r"v(2\.[01]|3\.0)")
_FIELD = re.compile(r"\{(\w+)(?::0?([0-9])d)?\}")
_RANGE = re.compile(r"(\d{1,15}):(\d{1,15})")

# Fields of episodes that locate their files, or that follow from their frames.
_OF_FILES = re.compile(r"(stats|data|meta|videos)/.*|dataset_(from|to)_index|tasks|length|episode_index")
_Count = Annotated[int, msgspec.Meta(ge=0, lt=1 << 50)]

FOLDER = "lerobot"
FILES_PER_CHUNK = 1000
FILE_BYTES = 100 << 20
_VERSION = "v3.0"
META_STYLE = store.ParquetStyle(rows_per_group=1 << 12, compression_level=3)
_POSE = ("x_m", "y_m", "z_m", "qx", "qy", "qz", "qw")
_AXES = ("height", "width", "channels")
_COMPONENTS = {STATE: list(_POSE), ACTION: list(_POSE[:2])}


class Mark(msgspec.Struct, frozen=True):
    """Mark of an export of this toolkit.

    ``clips``: an episode is a clip, not a round. ``extra``: the stored name of the further column in each
    feature: ``extra.NAME`` with an entry for each touch, or ``extra_seq.NAME`` for each frame.
    """

    class_names: tuple[str, ...]
    clips: bool
    extra: Mapping[str, str] = {}

    def own_name(self, feature: str) -> str:
        """Return the name of a further column in the data set; the name of another feature is unchanged."""
        return self.extra.get(feature, feature).removeprefix("extra_seq.").removeprefix("extra.")

    @property
    def per_touch(self) -> list[str]:
        """Names in the data set of the further columns with an entry for each touch."""
        return [self.own_name(name) for name, stored in self.extra.items() if stored.startswith("extra.")]


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
        return [name for name, each in self.features.items() if each.dtype in _PICTURES]

    @property
    def is_v2(self) -> bool:
        """Whether each episode has a file of its own, as in version 2."""
        return self.codebase_version.startswith("v2")

    def camera(self, name: str, where: str) -> str:
        """Return the feature of the pictures to import: the named one, or the only one that is not depth.

        Raises InputError if there is no such feature, or if there are several.
        """
        cameras = [key for key in self.pictures if not self.features[key].is_depth]
        return importing.chosen_pictures(cameras, name, where, "cameras", self.features)

    def split_of(self, episode: int) -> dict[str, object]:
        """Return the split of an episode as a field; empty if it is not stated."""
        for name, text in (self.splits or {}).items():
            found = _RANGE.fullmatch(text)
            if found and int(found[1]) <= episode < int(found[2]):
                return {"split": name}
        return {}


@dataclass(frozen=True)
class Episode:
    """An episode: the places and number of its frames, and its other fields."""

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
            f"{home.address(_INFO)!r} states version {importing.shown(info.codebase_version)!r}; "
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
                f"{home.address(path)!r}: {importing.shown(line)}; expected a number and a text"
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
    found = {name.removeprefix(prefix): value for name, value in line.items() if name.startswith(prefix)}
    return msgspec.convert(found, _Files)


def _filled(template: str, values: Mapping[str, object]) -> str:
    # `str.format` would look up attributes, and allocate as much memory as a template asks for.
    return _FIELD.sub(lambda found: str(values.get(found[1], found[0])).zfill(int(found[2] or 0)), template)


def _lines(home: store.DataFolder, path: str) -> Iterator[JsonObject]:
    """Yield the rows of a JSON Lines or Parquet file; columns of statistics are left out."""
    with _as_input_error(home, path):
        if path.endswith(".jsonl"):
            yield from msgspec.json.Decoder(JsonObject).decode_lines(_content(home, path))
            return
        parquet = flat_parquet.ForeignParquet(home, path)
        yield from parquet.rows([name for name in parquet.types if not name.startswith("stats/")])


def _content(home: store.DataFolder, path: str) -> bytes:
    with importing.open_source(home, path) as stream:
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


@dataclass(frozen=True)
class WriteMeta:
    """Writes the metadata of a LeRobotDataset after all its episodes."""

    step: Episodes
    tasks: tuple[str, ...]

    def __call__(self, folder: store.DataFolder, manifest: store.Manifest) -> dict[str, str]:
        """Return the checksum of each file of the LeRobotDataset by its path."""
        files = convert.checksums(folder, manifest)
        placed = [list(convert.files_of(folder, record.file)) for record in manifest.shards if record.rows]
        frames, episodes = (
            [read.Shard(folder.address(path)) for path in paths] for paths in zip(*placed, strict=True)
        )
        info = self._info(frames[0].schema, sum(map(len, episodes)), sum(map(len, frames)))
        meta = {
            "info.json": _json_bytes(info),
            "stats.json": _json_bytes(lerobot_statistics.statistics_of_all(episodes, frames)),
            "tasks.parquet": store.encode_parquet(_task_table(self.tasks), META_STYLE),
        }
        return files | convert.write_changed(folder, {f"{FOLDER}/meta/{name}": meta[name] for name in meta})

    def _info(self, frames: pa.Schema, episodes: int, total_frames: int) -> dict[str, object]:
        step = self.step
        mark = Mark(step.names, step.are_clips, {each.name: each.stored for each in step.extras})
        return {
            "codebase_version": _VERSION,
            "robot_type": None,
            "total_episodes": episodes,
            "total_frames": total_frames,
            "total_tasks": len(self.tasks),
            "chunks_size": FILES_PER_CHUNK,
            "data_files_size_in_mb": FILE_BYTES >> 20,
            "video_files_size_in_mb": 200,
            "fps": step.fps,
            "splits": {step.split: f"0:{episodes}"},
            "data_path": "data/chunk-{chunk_index:03d}/file-{file_index:03d}.parquet",
            "video_path": None,
            "features": {each.name: self._feature(each) for each in frames},
            "realtouch": msgspec.to_builtins(mark),
        }

    def _feature(self, each: pa.Field) -> dict[str, object]:
        if each.type == touch.MEDIA_TYPE:
            picture: dict[str, object] = {"dtype": "image", "shape": [*self.step.size, 3], "names": [*_AXES]}
            if each.name == DEPTH:
                picture |= {"shape": [*self.step.size, 1], "info": _DEPTH_INFO}
            return picture
        width = 1
        leaf = each.type
        if pa.types.is_fixed_size_list(leaf):
            width, leaf = leaf.list_size, leaf.value_type
        return {"dtype": read.dtype_name(leaf), "shape": [width], "names": _COMPONENTS.get(each.name)}


def _json_bytes(values: Mapping[str, object]) -> bytes:
    return (json.dumps(values, indent=4) + "\n").encode()


def _task_table(tasks: Sequence[str]) -> pa.Table:
    """Return the tasks as pandas stores a table with a named index."""
    table = pa.table({"task_index": pa.array(range(len(tasks)), pa.int64()), "task": pa.array(tasks)})
    columns = [
        {"name": name, "field_name": name, "pandas_type": kind, "numpy_type": stored, "metadata": None}
        for name, kind, stored in (("task_index", "int64", "int64"), ("task", "unicode", "object"))
    ]
    of_pandas = {"index_columns": ["task"], "column_indexes": [], "columns": columns}
    return table.replace_schema_metadata({"pandas": json.dumps({**of_pandas, "pandas_version": "2.0.0"})})
