"""Formats that can be imported, and how a source shows its format: by its file names and first bytes."""

from __future__ import annotations

import re
import zipfile
from collections.abc import Callable, Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import IO, NamedTuple

from realtouch.importing import import_columns, source_files, source_touches
from realtouch.kind import KIND
from realtouch.video import video_files
from tactile_toolkit import errors, kind, places, store
from tactile_toolkit.columns import tables

FindTouches = Callable[
    [store.DataFolder, import_columns.ImportColumns, str | None],
    Iterator[source_touches.FoundTouches | source_touches.Recording],
]
"""Yields the touches of a folder, or recordings to cut, given columns and the path of a table."""

_MAX_PATHS = 20_000
_MAX_FOLDERS = 200
_MAX_DEPTH = 3
_PATHS_SHOWN = 3
_TAR_OFFSET = 257
_ZIP = b"PK\x03\x04"

# First bytes of files that are not videos: offset, bytes.
_FIRST_BYTES: dict[str, tuple[tuple[int, bytes], ...]] = {
    "hdf5": ((0, b"\x89HDF\r\n\x1a\n"),),
    "flat": ((0, b"PAR1"),),
    "webdataset": ((_TAR_OFFSET, b"ustar"),),
    "replay": ((0, _ZIP),),
}
_OXT_MEMBER = re.compile(r"(^|/)data/\w+_tactile_type_\w+(/|\Z)")
_ZARR_MARKS = (".zgroup", "zarr.json")

# Formats that contain files of other formats: LeRobot has videos, Parquet files and tables.
_PARTS = {
    "lerobot": {"video", "flat", "folder"},
    "oxt": {"replay"},
    "anytouch": {"folder"},
    "fota": {"webdataset"},
}


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
    describe: Callable[[source_touches.FoundTouches], str] = lambda _touches: ""
    rotvec: bool = False


def _images(find: str, contents: source_files.ReadContents = source_files.contents_of) -> ImportFormat:
    """Return a format of images, each of which is a file or a part of one."""
    return ImportFormat(kind.lazy(f"realtouch.formats.{find}"), contents)


def _recordings(find: str, cut: str = "frames", *, rotvec: bool = False) -> ImportFormat:
    """Return a format of recordings whose files have pictures of one size."""
    reader = find.partition(":")[0]
    describe = kind.lazy(f"realtouch.formats.{reader}:describe_conversion")
    contents = kind.lazy(f"realtouch.formats.{reader}:read_contents")
    return ImportFormat(kind.lazy(f"realtouch.formats.{find}"), contents, cut, True, describe, rotvec)


IMPORTS: dict[str, ImportFormat] = {
    "folder": _images("media_files:find_folder"),
    "video": _recordings("media_files:find_video", "whole"),
    "flat": _images("flat_parquet:find_flat", kind.lazy("realtouch.formats.flat_parquet:read_contents")),
    "webdataset": _images("tar_samples:find_webdataset"),
    "lerobot": _recordings("lerobot_import:find_lerobot"),
    "oxt": _recordings("zarr_recordings:find_oxt", rotvec=True),
    "replay": _recordings("zarr_recordings:find_replay"),
    "hdf5": _recordings("hdf5:find_hdf5"),
    "fota": _images("tar_samples:find_fota"),
    "anytouch": _images("anytouch:find_anytouch"),
}
"""Formats that can be imported; :func:`recognised` recognises them by their content."""


class Recognised(NamedTuple):
    """The format of a source, and the file by which it was recognised."""

    layout: str
    by: str


def _ends_with(*endings: str) -> Callable[[str], object]:
    return lambda path: path.lower().endswith(endings)


# Marks of formats: which paths show that a source has a format.
_MARKS: tuple[tuple[str, Callable[[str], object]], ...] = (
    ("lerobot", re.compile(r"^meta/info\.json\Z").search),
    ("oxt", _OXT_MEMBER.search),
    ("replay", lambda path: path.rpartition("/")[2] in _ZARR_MARKS and path.count("/") <= 1),
    ("replay", _ends_with(".zarr.zip")),
    ("anytouch", re.compile(r"^\w+_bg\.txt\Z").search),
    ("fota", re.compile(r"^(\w+/)?count\.txt\Z").search),
    ("webdataset", re.compile(r"^[^/]+\.tar\Z", re.IGNORECASE).search),
    ("hdf5", _ends_with(".h5", ".hdf5")),
    ("video", _ends_with(*video_files.VIDEO_ENDINGS)),
    ("folder", _ends_with(*(f".{ending}" for ending in source_files.IMAGE_ENDINGS))),
    ("flat", _ends_with(".parquet")),
    ("folder", _ends_with(*tables.TEXT_ENDINGS, ".jsonl")),
)

_PICKLES = _ends_with(".pkl", ".pickle")
_TABLES = _ends_with(*tables.ENDINGS)


def recognised(place: str) -> Recognised:
    """Return the format of a file or folder.

    Raises InputError if no format or several formats are recognised; it names the option that states one.
    """
    home = store.open_folder(place)
    if home.is_local and Path(place).is_file():
        return _of_file(place)
    ours = _of_export(home)
    if ours is not None:
        return ours
    paths = _paths(home)
    found: dict[str, str] = {}
    for layout, fits in _MARKS:
        if layout not in found:
            first = next(filter(fits, paths), None)
            if first is not None:
                found[layout] = first
    for whole in [each for each in found if each in _PARTS]:
        found = {layout: first for layout, first in found.items() if layout not in _PARTS[whole]}
    if len(found) > 1:  # a table describes the files beside it
        found = {layout: first for layout, first in found.items() if not _TABLES(first)} or found
    if [*found] == ["folder"]:
        # The images beside the pickles of Sparsh are backgrounds, which must not pass for touches.
        _refuse_pickles([path for path in paths if path.count("/") < 2])
    if not found:
        _refuse_pickles(paths)
        shown = ", ".join(paths[:_PATHS_SHOWN]) or "nothing"
        raise errors.InputError(
            f"{place!r} holds no recordings of a known format (found {shown})",
            next=f"name the format with --format: {', '.join(IMPORTS)}",
        )
    if len(found) > 1:
        words = ", ".join(f"{layout} ({first})" for layout, first in found.items())
        raise errors.InputError(
            f"{place!r} can be read in several formats: {words}", next="name one with --format"
        )
    ((layout, first),) = found.items()
    return Recognised(layout, first)


def _refuse_pickles(paths: Sequence[str]) -> None:
    """Raise InputError if one of the paths is a pickle."""
    pickle = next(filter(_PICKLES, paths), None)
    if pickle is not None:
        raise errors.InputError(
            f"{pickle!r} is a pickle, as Sparsh stores images; pickles are not read, because reading one can "
            "run any program",
            next="write each image to a file, with the program that made the pickle, and import the folder; "
            "`--format folder` imports the images beside it",
        )


def _of_file(place: str) -> Recognised:
    folder, name = source_files.source_of(place)
    with folder.open_inside(name) as stream:
        head = video_files.read_start(stream)
        if head.startswith(_ZIP) and _is_oxt(stream):
            return Recognised("oxt", name)
    if video_files.demuxer_of(head):
        return Recognised("video", name)
    for layout, marks in _FIRST_BYTES.items():
        if any(head[at : at + len(mark)] == mark for at, mark in marks):
            return Recognised(layout, name)
    _refuse_pickles([name])
    found = "is empty"
    if head:
        found = f"begins with {head[:8].hex(' ')}"
    raise errors.InputError(
        f"{place!r} {found}; expected a video, a tar, or a file of Parquet, HDF5 or Zarr",
        next="give its folder, with --table for a table; or name the format with --format",
    )


def _is_oxt(stream: IO[bytes]) -> bool:
    # A damaged zip, or one that Python does not read, is refused where its arrays are read.
    with suppress(zipfile.BadZipFile, OSError, ValueError, NotImplementedError):
        return any(map(_OXT_MEMBER.search, zipfile.ZipFile(stream).namelist()))
    return False


def _of_export(home: store.DataFolder) -> Recognised | None:
    """Return the format of an export of this toolkit, as its manifest states it; None for other folders."""
    if store.manifest_so_far(home) is None:
        return None
    place = places.open_place(home.address()).require(KIND, "import")
    if place.spec.get("operation") not in ("export", "frames"):
        raise errors.InputError(
            f"{home.address()!r} is a data set already; it needs no import",
            next="open it with `realtouch.load`",
        )
    layout = dict(place.spec["options"]).get("layout", "folder")
    return Recognised(str(layout), store.MANIFEST_FILE)


def _paths(home: store.DataFolder) -> Sequence[str]:
    """List visible paths in a folder and two levels below it; the list of a very large folder is cut off."""
    paths = list[str]()
    folders = [""]
    for _ in range(_MAX_DEPTH):
        inner: list[str] = []
        for folder in folders[:_MAX_FOLDERS]:
            for name, size in sorted(home.entries(folder).items()):
                path = f"{folder}/{name}".strip("/")
                if store.is_hidden(path) and name not in _ZARR_MARKS:
                    continue
                if size is None:
                    inner.append(path)
                paths.append(path)
            if len(paths) > _MAX_PATHS:
                return paths
        folders = inner
    return paths
