"""Recognise the format of a source by its names and first bytes; name other known formats, with advice."""

from __future__ import annotations

import re
import zipfile
import zlib
from collections.abc import Callable, Sequence
from contextlib import suppress
from pathlib import Path
from typing import IO, NamedTuple

from numpy.lib import format as npy_format

from realtouch.importing import import_options, source_files
from realtouch.kind import KIND
from realtouch.video import video_files
from tactile_toolkit import errors, places, store, touch, wording
from tactile_toolkit.columns import known_formats, tables

BAG_ENDINGS = (".mcap", ".bag", ".bag.active", ".db3")
"""Endings of the names of ROS bags, in lower case; one is that of a recorder of ROS 1 that was stopped."""

_MAX_PATHS = 20_000
_MAX_FOLDERS = 200
_MAX_DEPTH = 3
_PATHS_SHOWN = 3
_ARRAYS_SHOWN = 8
# What a damaged zip, or an array in it, raises.
_DAMAGE = (
    *(zipfile.BadZipFile, zlib.error, OSError, EOFError, ValueError, RuntimeError),
    *(LookupError, TypeError, SyntaxError, MemoryError, OverflowError),
)
_ZIP = b"PK\x03\x04"
# Formats of files that are not videos, by their keys among the known formats.
_LAYOUTS = {"hdf5": "hdf5", "parquet": "flat", "tar": "webdataset", "zip": "replay", "bag": "rosbag"}
_OXT_MEMBER = re.compile(r"(^|/)data/\w+_tactile_type_\w+(/|\Z)")
_ZARR_MARKS = (".zgroup", "zarr.json")
# Formats that contain files of other formats: LeRobot has videos, Parquet files and tables.
_PARTS = {
    "lerobot": {"video", "flat", "folder"},
    "oxt": {"replay"},
    "anytouch": {"folder"},
    "fota": {"webdataset"},
}


class Recognised(NamedTuple):
    """The format of a source, the file by which it was recognised, and whether it is our own export."""

    layout: str
    by: str
    is_export: bool = False


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
    ("rosbag", _ends_with(*BAG_ENDINGS)),
    ("video", _ends_with(*video_files.VIDEO_ENDINGS)),
    ("folder", _ends_with(*source_files.IMAGE_ENDINGS)),
    ("flat", _ends_with(".parquet")),
    ("folder", _ends_with(*tables.Table.TEXT_ENDINGS, ".jsonl")),
)
_TABLES = _ends_with(*tables.Table.ENDINGS)


def recognised(address: str) -> Recognised:
    """Return the format of a file or folder.

    Raises InputError if no format or several formats are recognised; it names the option that states one.
    """
    home = store.open_folder(address)
    if home.is_local and Path(address).is_file():
        return _of_file(address)
    ours = _of_export(home)
    if ours is not None:
        return ours
    paths = _paths(home)
    marked: dict[str, str] = {}
    for layout, fits in _MARKS:
        if layout not in marked:
            first = next(filter(fits, paths), None)
            if first is not None:
                marked[layout] = first
    for whole in [layout for layout in marked if layout in _PARTS]:
        marked = {layout: first for layout, first in marked.items() if layout not in _PARTS[whole]}
    if len(marked) > 1:  # a table describes the files beside it
        marked = {layout: first for layout, first in marked.items() if not _TABLES(first)} or marked
    if [*marked] == ["folder"]:
        # The images beside the pickles of Sparsh are backgrounds, which must not pass for touches.
        near = [path for path in paths if path.count("/") < 2]
        known = [(path, known_formats.KnownFormat.by_ending(path)) for path in near]
        _refuse_foreign(home, [path for path, held in known if held is not None and held.key == "pickle"])
    if not marked:
        _refuse_foreign(home, paths)
        shown = ", ".join(paths[:_PATHS_SHOWN]) or "nothing"
        raise errors.InputError(
            f"{address!r} holds no recordings of a known format (found {shown})",
            next=f"name the format with --format: {', '.join(import_options.IMPORT_LAYOUTS)}",
        )
    if len(marked) > 1:
        words = ", ".join(f"{layout} ({first})" for layout, first in marked.items())
        raise errors.InputError(
            f"{address!r} can be read in several formats: {words}", next="name one with --format"
        )
    ((layout, first),) = marked.items()
    return Recognised(layout, first)


# What to do with files of some formats, instead of the step that is usual for the format.
_STEPS = {
    "pickle": "write each image to a file, with the program that made the pickle, and import the folder; "
    "`--format folder` imports the images beside it",
    "numpy": 'write its arrays to an HDF5 file, by python -c "import h5py, numpy; '
    "h5py.File('arrays.hdf5', 'w').update({array})\", and import that with --map image=NAME",
}
# Keys of formats that are read, in some or all cases.
_READ = (*_LAYOUTS, "archive", "gzip", "video", "json", "pixels")


def reason_unread(path: str, layout: str) -> str:
    """Return why a file of a source is not read in a format, in a few words."""
    if _TABLES(path):
        return "a table that was not named; see --table, --stream and --cut"
    if path.lower().endswith(source_files.IMAGE_ENDINGS):
        return "a picture that no table names" if layout == "folder" else "a picture"
    known = known_formats.KnownFormat.by_ending(path)
    return f"not of the format {layout}" if known is None else known.name


def _refuse_foreign(folder: store.DataFolder, paths: Sequence[str], head: bytes | None = None) -> None:
    """Raise InputError for the first path of a known format that is not read, by name or first bytes."""
    for path in paths:
        candidates = [known_formats.KnownFormat.by_ending(path)]
        if head is not None:
            candidates.append(known_formats.KnownFormat.of(head))
        known = next((known for known in candidates if known and known.key not in _READ), None)
        if known is None:
            continue
        what = known.name
        advice = _STEPS.get(known.key, known.step)
        if known.key == "numpy":
            what += _arrays_of(folder, path)
            loaded = f"numpy.load({folder.address(path)!r})"
            if path.lower().endswith(".npy"):
                loaded = f"array={loaded}"
            advice = advice.replace("{array}", loaded)
        raise errors.InputError(f"{path!r} is {what}", next=advice)


def _arrays_of(folder: store.DataFolder, path: str) -> str:
    """Return the names and shapes of the arrays of an NPZ file, for a message; empty if there are none."""
    arrays = []
    with (
        suppress(*_DAMAGE, errors.ItemError),
        folder.open_inside(path) as stream,
        zipfile.ZipFile(stream) as archive,
    ):
        for name in archive.namelist()[:_ARRAYS_SHOWN]:
            with archive.open(name) as member:
                version = npy_format.read_magic(member)
                read_header = {(1, 0): npy_format.read_array_header_1_0}.get(
                    version, npy_format.read_array_header_2_0
                )
                shape, _, dtype = read_header(member)
            arrays.append(f"{wording.printable(name.removesuffix('.npy'))} {dtype} {shape}")
    return f", with the arrays {', '.join(arrays)}" if arrays else ""


def _of_file(path: str) -> Recognised:
    folder, name = source_files.source_of(path)
    with folder.open_inside(name) as stream:
        head = video_files.read_start(stream)
        if head.startswith(_ZIP) and _is_oxt(stream):
            return Recognised("oxt", name)
    if video_files.demuxer_of(head):
        return Recognised("video", name)
    _refuse_foreign(folder, [name], head)
    known = known_formats.KnownFormat.of(head)
    if known is not None and known.key in _LAYOUTS:
        return Recognised(_LAYOUTS[known.key], name)
    start = head[:8].hex(" ")
    raise errors.InputError(
        f"{path!r} begins with {start}; expected a video, a tar, a ROS bag, or a file of Parquet, HDF5 or "
        "Zarr",
        next="give its folder, with --table for a table; or name the format with --format",
    )


def _is_oxt(stream: IO[bytes]) -> bool:
    # A damaged zip, or one that Python does not read, is refused where its arrays are read.
    with suppress(*_DAMAGE):
        return any(map(_OXT_MEMBER.search, zipfile.ZipFile(stream).namelist()))
    return False


def _of_export(home: store.DataFolder) -> Recognised | None:
    """Return the format of an export of this toolkit, as its manifest states it; None for other folders."""
    if store.Manifest.so_far(home) is None:
        return None
    data_set = places.open_place(home.address()).require(KIND, "realtouch import")
    if data_set.spec.get("operation") != "export":
        raise errors.InputError(
            f"{home.address()!r} is a data set already; it needs no import",
            next="open it with `realtouch.load`",
        )
    layout = str(data_set.spec["options"]["layout"])
    if layout in touch.IMAGE_SUFFIX:
        layout = "folder"
    if layout not in import_options.IMPORT_LAYOUTS:
        raise errors.InputError(
            f"{home.address()!r} is an export for {layout}, which is not imported",
            next="give the data set that it was made of",
        )
    return Recognised(layout, store.MANIFEST_FILE, True)


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
