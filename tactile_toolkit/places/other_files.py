"""Folders and files without a data set: their kinds, and the commands that accept them."""

from __future__ import annotations

from collections import Counter
from pathlib import PurePosixPath

from tactile_toolkit import store
from tactile_toolkit.errors import InputError
from tactile_toolkit.wording import with_count

_PARQUET_MARK = b"PAR1"
_PICTURES = (
    "avif bmp dib gif heic heif j2k jfif jp2 jpe jpeg jpg pgm png pnm ppm tga tif tiff webp".split()  # noqa: SIM905
)
_SOLIDS = ("3mf", "glb", "gltf", "obj", "off", "ply", "stl")
_TABLES = ("arrow", "csv", "feather", "h5", "hdf5", "json", "jsonl", "npy", "npz", "tsv", "xlsx")
_ARCHIVES = ("tar", "tgz", "zip")
_VIDEOS = ("avi", "m4v", "mkv", "mov", "mp4", "ts", "webm")

_PICTURE_STEP = (
    "make digits of pictures with `mnist3d generate --source folder --images FOLDER`, or import touches with "
    "`realtouch import FOLDER`"
)
_SOLID_STEP = "check meshes with `mnist3d validate FILE`, touch them with `tactile-sim generate FILE`"
_IMPORT_STEP = "import touches with `realtouch import SOURCE --out FOLDER`"
_PARQUET_STEP = "write the rows as Parquet files, or give the folder of a data set"

# By file extension: what a file is, what several are, and the next step.
_ENDINGS = {
    **dict.fromkeys(_PICTURES, ("a picture", "pictures", _PICTURE_STEP)),
    **dict.fromkeys(_SOLIDS, ("a mesh", "meshes", _SOLID_STEP)),
    **dict.fromkeys(_TABLES, ("a table or an array", "tables or arrays", _PARQUET_STEP)),
    **dict.fromkeys(_ARCHIVES, ("an archive", "archives", _IMPORT_STEP)),
    **dict.fromkeys(_VIDEOS, ("a video", "videos", _IMPORT_STEP)),
}
# Files that identify a kind of folder: what it is, and the next step.
_MARKS = {
    ("dataset_dict.json", "state.json", "dataset_info.json"): (
        "was written by `save_to_disk` of `datasets`",
        "load it there (`datasets.load_from_disk`) and write each split with `to_parquet`",
    ),
    (".zgroup", ".zarray", ".zattrs", "zarr.json"): ("is a Zarr array or group", _IMPORT_STEP),
}
_MAX_SHOWN = 3
_MAX_LOOKED_AT = 10_000


def is_parquet_file(folder: store.DataFolder, path: str) -> bool:
    """Return whether a file is a Parquet file by its name or its first bytes."""
    if path.endswith(".parquet"):
        return True
    with folder.open(path) as stream:
        return stream.read(len(_PARQUET_MARK)) == _PARQUET_MARK


def is_interrupted(folder: store.DataFolder) -> bool:
    """Return whether a folder has shard records of an unfinished run."""
    return bool(store.pending_shards(folder.names(store.PENDING_FOLDER)))


def not_a_set(folder: store.DataFolder, name: str, path: str = "") -> InputError:
    """Return the error for a folder, or a file in it, without a data set; it names what was found."""
    found, next_step = _file_in_words(path) if path else _folder_in_words(folder)
    return InputError(f"{name!r} {found}; expected a data set of Parquet files", next=next_step)


def _file_in_words(path: str) -> tuple[str, str]:
    one, _, next_step = _ENDINGS.get(_ending(path), ("a file of another kind", "", _PARQUET_STEP))
    return f"is {one}", next_step


def _folder_in_words(folder: store.DataFolder) -> tuple[str, str]:
    entries = folder.entries()
    if not entries:
        return "is empty", "make a data set there, or give another folder"
    for marks, words in _MARKS.items():
        if any(mark in entries for mark in marks):
            return words
    if folder.exists("meta/info.json"):
        return "is a LeRobotDataset", _IMPORT_STEP
    if is_interrupted(folder):
        return (
            f"is the folder of a run that was interrupted, and its {store.MANIFEST_FILE} is missing",
            "run the same command again, it continues",
        )
    folders = [name for name, size in entries.items() if size is None and not name.startswith(".")]
    sets = [name for name in folders if folder.exists(f"{name}/{store.MANIFEST_FILE}")]
    if sets:
        shown = ", ".join(sets[:_MAX_SHOWN])
        return (
            f"holds {with_count(len(sets), 'data sets')} ({shown})",
            f"give one of them, such as {sets[0]!r}",
        )
    return _contents_in_words(folder)


def _contents_in_words(folder: store.DataFolder) -> tuple[str, str]:
    """Name the most frequent kind of file in a folder and its sub-folders."""
    files: list[str] = []
    for name, size in folder.entries().items():
        if size is not None:
            files.append(name)
        elif not name.startswith("."):
            files += [f"{name}/{each}" for each in folder.names(name)]
        if len(files) > _MAX_LOOKED_AT:
            break
    zarr = next((path for path in files if path.endswith((".zgroup", "zarr.json"))), None)
    if zarr is not None:
        return "holds Zarr arrays", _IMPORT_STEP
    counts = Counter(_ENDINGS[_ending(path)][1:] for path in files if _ending(path) in _ENDINGS)
    if not counts:
        shown = ", ".join(map(repr, sorted(folder.names())[:_MAX_SHOWN]))
        return f"holds no Parquet files (found {shown})", "give the folder of a data set"
    # Tables beside pictures, videos or meshes describe them.
    tables = _ENDINGS[_TABLES[0]][1:]
    ((kind, next_step), count), *_ = sorted(counts.most_common(), key=lambda each: each[0] == tables)
    first = next(path for path in files if _ENDINGS.get(_ending(path), ("", "", ""))[1] == kind)
    return f"is a folder of {kind} ({count:,}, such as {first!r})", next_step


def _ending(path: str) -> str:
    return PurePosixPath(path).suffix[1:].lower()
