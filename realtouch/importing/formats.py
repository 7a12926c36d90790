"""The formats of recordings that are read, each by a module of ``realtouch.exchange``."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Any

from realtouch.import_columns import ImportColumns
from realtouch.importing.found_touches import FoundTouches
from realtouch.importing.source_files import ReadContents, contents_of
from tactile_toolkit import store
from tactile_toolkit.kind import lazy


@dataclass(frozen=True)
class ImportFormat:
    """How a format is read.

    ``find`` takes a folder, the columns and the path of a table, and yields touches, or recordings to cut.
    ``contents`` yields the pictures of touches, encoded: as many for each touch as it has. ``cut`` is how
    recordings become touches by default. ``is_one_a_file`` says that pictures of a file have one size.
    ``describe`` states how pictures are converted; empty if they are taken as they are. With ``rotvec`` the
    format has rotation vectors in poses of six numbers.
    """

    find: Callable[[store.DataFolder, ImportColumns, str | None], Iterator[Any]]
    contents: ReadContents = contents_of
    cut: str = "frames"
    is_one_a_file: bool = False
    describe: Callable[[FoundTouches], str] = lambda _touches: ""
    rotvec: bool = False


def _images(layout: str) -> ImportFormat:
    """Return a format of images, each a file or part of one."""
    return ImportFormat(lazy(f"realtouch.exchange.{layout}_import:find_{layout}"))


def _recordings(layout: str, cut: str = "frames", *, rotvec: bool = False) -> ImportFormat:
    """Return a format of recordings, each file of which has pictures of one size."""
    module = f"realtouch.exchange.{layout}_import"
    reader, describe = lazy(f"{module}:encoded_frames"), lazy(f"{module}:describe_conversion")
    return ImportFormat(lazy(f"{module}:find_{layout}"), reader, cut, True, describe, rotvec)


IMPORTS: dict[str, ImportFormat] = {
    "folder": _images("folder"),
    "video": _recordings("video", "whole"),
    "flat": ImportFormat(
        lazy("realtouch.exchange.flat_import:find_flat"), lazy("realtouch.exchange.flat_import:stored_images")
    ),
    "webdataset": _images("webdataset"),
    "lerobot": _recordings("lerobot"),
    "oxt": _recordings("oxt", rotvec=True),
    "replay": _recordings("replay"),
    "hdf5": _recordings("hdf5"),
    "fota": _images("fota"),
    "sparsh": _images("sparsh"),
    "anytouch": _images("anytouch"),
}
"""Formats that are read; each is recognised by its content (:mod:`realtouch.importing.recognised`)."""
