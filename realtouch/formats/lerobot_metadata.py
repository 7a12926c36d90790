"""Metadata of a LeRobotDataset: features, episodes and tasks."""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Annotated

import msgspec

from realtouch import importing
from realtouch.formats import foreign_parquet, lerobot_mark
from tactile_toolkit import errors, store
from tactile_toolkit.json_types import JsonObject

_INFO = "meta/info.json"
_PICTURES = ("image", "video")
_DEPTH = ("is_depth_map", "video.is_depth_map")
_MAX_BYTES = 256 << 20
_READABLE_VERSION = re.compile(r"v(2\.[01]|3\.0)")
_FIELD = re.compile(r"\{(\w+)(?::0?([0-9])d)?\}")
_RANGE = re.compile(r"(\d{1,15}):(\d{1,15})")
# Fields of episodes that locate their files, or that follow from their frames.
_OF_FILES = re.compile(r"(stats|data|meta|videos)/.*|dataset_(from|to)_index|tasks|length|episode_index")
_Count = Annotated[int, msgspec.Meta(ge=0, lt=1 << 50)]


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
    realtouch: lerobot_mark.Mark | None = None

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
        number, texts = line.get("task_index"), [value for value in line.values() if isinstance(value, str)]
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
        parquet = foreign_parquet.ForeignParquet(home, path)
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
