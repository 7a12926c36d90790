"""Videos: each file is a recording, with what a table or its folder says of it."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import replace
from itertools import chain, groupby, repeat
from operator import attrgetter
from pathlib import PurePosixPath
from typing import Any

import numpy as np

from realtouch import video, video_files
from realtouch.importing import found_touches
from realtouch.importing.cut_tables import RECORDING_COLUMNS
from realtouch.importing.fields import NUMBERED
from realtouch.importing.found_touches import FoundTouch, path_of, source_of
from realtouch.importing.recordings import Recording
from realtouch.touch_options import ImportColumns
from tactile_toolkit import store
from tactile_toolkit.errors import InputError, ItemError
from tactile_toolkit.text_tables import TABLE_ENDINGS, table_lines

_FILE = "file"
_HEADER_BYTES = 1 << 16
_FIRST_LINES = 3  # the separator, the columns, a line


def find_video(home: store.DataFolder, columns: ImportColumns, table: str | None) -> Iterator[Recording]:
    """Yield a recording for each video: the file that was named, or those of a folder and its sub-folders.

    A table says something of each: the one that was named, or the only one in the folder whose column of
    files names some. Then a video without a line is a problem, as a line without a video is. Without a table,
    the folders that hold all videos are their classes.
    """
    folder, paths = _videos(home)
    stems = Counter(map(_stem, paths))
    lines = _lines(folder, columns.image or _FILE, table, paths)
    said, unnamed = _classes(paths), None
    if lines is not None:
        said, unnamed = {}, ItemError("table", "no line of the table names this video; expected one")
    seen = set[str]()
    for path, values in lines or ():
        problem = None
        if path in seen:
            problem = ItemError("duplicate", "the same file as in an earlier line of the table")
        elif None in values:
            problem = ItemError("columns", "the line has more values than the table has columns")
        seen.add(path)
        yield _recording(folder, path, values, problem, stems)
    for path in paths:
        if path not in seen:
            yield _recording(folder, path, said.get(path, {}), unnamed, stems)


def _recording(
    folder: store.DataFolder,
    path: str,
    said: Mapping[str, object],
    problem: ItemError | None,
    stems: Mapping[str, int],
) -> Recording:
    """Return a video with what is said of it; one that cannot be used has a problem, and one picture."""
    name = path if stems[_stem(path)] > 1 else _stem(path)
    whole = Recording(name, folder.address(), path, "", 0, 1, 0, {_FILE: path, **said}, time_s=np.zeros(1))
    try:
        if problem is not None:
            raise problem
        store.size_inside(folder, path)
        found = video.open_video(folder, path)
    except ItemError as error:
        return replace(whole, problem=error)
    size, times = found.picture_bytes, found.time_s
    return replace(whole, part=found.conversion, frames=len(times), frame_bytes=size, time_s=times)


def _stem(path: str) -> str:
    return path.removesuffix(PurePosixPath(path).suffix)


def _videos(home: store.DataFolder) -> tuple[store.DataFolder, list[str]]:
    """Return a folder and the paths of the videos in it, or where the file lies that was named."""
    if (home.info("") or {}).get("type") == "file":
        folder, name = source_of(home.address())
        return folder, [name]
    paths = [path for path in home.walk() if not store.is_hidden(path) and video_files.is_video(home, path)]
    if not paths:
        raise InputError(f"{home.address()!r} holds no videos; expected AVI, MP4, MOV, MKV, WebM or MPEG-TS")
    return home, paths


def _classes(paths: Sequence[str]) -> dict[str, dict[str, object]]:
    """Return the class of each video where all lie one folder deep, in two folders or more."""
    folders = {path: path.split("/")[0] for path in paths if path.count("/") == 1}
    if len(folders) < len(paths) or len({*folders.values()}) < 2:
        return {}
    return {path: {NUMBERED: name} for path, name in folders.items()}


def _lines(
    home: store.DataFolder, image: str, table: str | None, paths: Sequence[str]
) -> list[tuple[str, dict[str, Any]]] | None:
    """Return the path of each line of the table, and the line; None if there is no table."""

    def read(folder: store.DataFolder, name: str) -> list[tuple[str, dict[str, Any]]]:
        names, lines = found_touches.read_table(folder, name)
        found_touches.require_columns(names, [image], folder.address(name))
        return [(path_of(str(each[image] or "")), each) for each in lines]

    if table is not None:
        return read(*source_of(table))
    found, refused = {}, None
    streams = tuple(f"{_stem(path)}{mark}" for path in paths for mark in "._")
    for name in found_touches.visible_files(home, TABLE_ENDINGS):
        if name.startswith(streams):
            continue
        names, line = _beginning(home, name)
        if image in names:
            lines = read(home, name)
            if {path for path, _ in lines}.intersection(paths):
                found[name] = lines
        elif not {*RECORDING_COLUMNS}.intersection(names):  # no table of cuts
            other = [column for column, value in line.items() if value and path_of(str(value)) in paths]
            refused = refused or (other and (name, other[0]))
    if len(found) > 1:
        words = f"{home.address()!r} has several tables of its videos: {', '.join(found)}"
        raise InputError(words, next="name one with --table")
    if refused and not found:
        name, column = refused
        words = f"{home.address(name)!r} names videos in its column {column!r}; expected a column {image!r}"
        raise InputError(words, next=f"add --map image={column}, or move the table out of the folder")
    return next(iter(found.values()), None)


def _beginning(home: store.DataFolder, name: str) -> tuple[list[str], dict[str, Any]]:
    """Return the columns of a table and its first line; the table may be long, or of no text."""
    with suppress(InputError), found_touches.open_source(home, name) as stream:
        names, lines = table_lines(b"\n".join(stream.read(_HEADER_BYTES).split(b"\n")[:_FIRST_LINES]), name)
        return names, next(iter(lines), {})
    return [], {}


def describe_conversion(items: Sequence[FoundTouch]) -> str:
    """Return what is done to the pictures of videos; empty if they are stored as they are."""
    return "; ".join(sorted({item.part for item in items} - {""}))


def encoded_frames(items: Iterable[FoundTouch]) -> Iterator[bytes | ItemError]:
    """Yield the pictures of each item in order; those of one file are read in one go."""
    for (home, path), group in groupby(items, key=attrgetter("file")):
        ranges = [range(item.start, item.start + max(1, item.frames)) for item in group]
        left = sum(map(len, ranges))
        try:
            for picture in video.pictures_of_video(
                store.open_folder(home), path, chain.from_iterable(ranges)
            ):
                left -= 1
                yield picture
        except ItemError as error:
            yield from repeat(error, left)
