"""The formats of recordings that can be imported; a module of ``realtouch.formats`` reads each of them."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import partial

from realtouch.importing import found_touches, import_columns, recordings, source_files
from tactile_toolkit import kind, store

FindTouches = Callable[
    [store.DataFolder, import_columns.ImportColumns, str | None],
    Iterator[found_touches.FoundTouches | recordings.Recording],
]
"""Yields the touches of a folder, or recordings to cut, given columns and the path of a table."""


@dataclass(frozen=True)
class ImportFormat:
    """How a format is read.

    ``contents`` yields all pictures of each touch, encoded. ``cut`` is how recordings become touches by
    default. ``one_size_per_file`` says that the pictures of a file have one size. ``describe`` states how
    pictures are converted; empty if they are stored as they are. With ``rotvec``, the last three of a pose of
    six numbers are a rotation vector.
    """

    find: FindTouches
    contents: source_files.ReadContents = source_files.contents_of
    cut: str = "frames"
    one_size_per_file: bool = False
    describe: Callable[[found_touches.FoundTouches], str] = lambda _touches: ""
    rotvec: bool = False


def _images(
    layout: str, module: str = "", contents: source_files.ReadContents = source_files.contents_of
) -> ImportFormat:
    """Return a format of images, each of which is a file or a part of one."""
    return ImportFormat(kind.lazy(f"realtouch.formats.{module or layout}:find_{layout}"), contents)


def _recordings(
    layout: str, module: str, reader: str, cut: str = "frames", *, rotvec: bool = False
) -> ImportFormat:
    """Return a format of recordings whose files have pictures of one size; ``reader`` is a module."""
    find = kind.lazy(f"realtouch.formats.{module}:find_{layout}")
    describe = kind.lazy(f"realtouch.formats.{reader}:describe_conversion")
    return ImportFormat(find, _contents(f"{reader}:read_frames"), cut, True, describe, rotvec)


def _contents(reader: str) -> source_files.ReadContents:
    return partial(source_files.pictures_by_file, kind.lazy(f"realtouch.formats.{reader}"))


IMPORTS: dict[str, ImportFormat] = {
    "folder": _images("folder", "folder_import"),
    "video": _recordings("video", "video_import", "video_import", "whole"),
    "flat": _images("flat", contents=_contents("foreign_parquet:read_rows")),
    "webdataset": _images("webdataset", "webdataset_import"),
    "lerobot": _recordings("lerobot", "lerobot_import", "lerobot_import"),
    "oxt": _recordings("oxt", "oxt", "zarr_recordings", rotvec=True),
    "replay": _recordings("replay", "replay", "zarr_recordings"),
    "hdf5": _recordings("hdf5", "hdf5_import", "hdf5_import"),
    "fota": _images("fota"),
    "anytouch": _images("anytouch"),
}
"""Formats that can be imported; :mod:`realtouch.importing.recognised` recognises them by their content."""
