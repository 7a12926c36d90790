"""Files of a folder or repository: the split of each Parquet file, and what a folder without any holds."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from fnmatch import fnmatchcase
from functools import cache
from pathlib import PurePosixPath
from typing import TypeAlias

from tactile_toolkit import errors, store, wording
from tactile_toolkit.kind import DatasetKind
from tactile_toolkit.store.folder import PENDING_FOLDER
from tactile_toolkit.store.manifest import DATA_FOLDER, VIEWER_FOLDER, pending_shards
from tactile_toolkit.value_types import JsonObject

PARQUET = ".parquet"
_CARD = store.CARD_FILE
USUAL_SPLIT = "train"
# Words for each split in names of files and folders, between separators.
_KEYWORDS = {
    "train": ("train", "training"),
    "validation": ("validation", "valid", "dev", "val"),
    "test": ("test", "testing", "eval", "evaluation"),
}
_SPLIT_OF_WORD = {word: split for split, words in _KEYWORDS.items() for word in words}
_SEPARATORS = re.compile("[-._ 0-9]+")
# Earlier releases of `datasets` append a digest to the count.
_SHARD = re.compile(r"(\w+)-\d{5,}-of-\d{5,}(?:[-.].*)?\.parquet")
_SPLIT_NAME = re.compile(r"\w[\w.-]*")
# Folders of Parquet files without rows of the data set.
_OTHER_FOLDERS = ("reports", VIEWER_FOLDER)
_LARGEST_CARD_BYTES = 1 << 20
Splits: TypeAlias = dict[str, tuple[str, ...]]
"""Paths of the Parquet files of each split, both in order."""
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


def parquet_paths(paths: Iterable[str]) -> list[str]:
    """Return the paths of visible Parquet files in natural order."""
    # A path that leads out of the folder is kept here and refused later, by name.
    files = [path for path in paths if path.endswith(PARQUET) and (".." in path or not store.is_hidden(path))]
    return sorted(files, key=wording.natural_key)


def splits_by_name(paths: Iterable[str], source: str) -> Splits:
    """Sort Parquet files by split, by the first of these rules that applies.

    If there are shards in ``data``, ``data/SPLIT-00000-of-00001.parquet``, only these; otherwise by a folder
    whose name is that of a split or has one of its keywords, then by the name of the file. A file name
    without any of these is a split of its own, or in other folders ``train``.

    Parameters
    ----------
    paths : iterable of str
        Paths in the folder or repository, with slashes.
    where : str
        Its name, for messages.

    Returns
    -------
    dict of str to tuple of str

    Raises
    ------
    InputError
        Two folders hold files of one split.
    """
    files = [path for path in parquet_paths(paths) if path.partition("/")[0] not in _OTHER_FOLDERS]
    shards = [path for path in files if _is_shard_in_data(path)]
    holders: dict[str, dict[str, list[str]]] = {}
    for path in shards or files:
        split, folder = _split_of(path)
        holders.setdefault(split, {}).setdefault(folder, []).append(path)
    for split, folders in holders.items():
        if len(folders) > 1:
            named = " and ".join(repr(folder or ".") for folder in list(folders)[:2])
            raise errors.InputError(
                f"{source!r} has files of split {split!r} in {named}, and no {_CARD} states which of "
                "them is the split",
                next=f"give one of these folders, or name the files of each split in {_CARD} (`configs`)",
            )
    return {split: tuple(next(iter(folders.values()))) for split, folders in sorted(holders.items())}


def has_shards(paths: Iterable[str]) -> bool:
    """Return whether there is a shard in ``data``; then other folders do not count."""
    return any(map(_is_shard_in_data, paths))


def _is_shard_in_data(path: str) -> bool:
    folder, _, name = path.rpartition("/")
    return folder == DATA_FOLDER and _SHARD.fullmatch(name) is not None


def _split_of(path: str) -> tuple[str, str]:
    """Return the split that a path states, and the folder that states it or holds the file."""
    *folders, name = path.split("/")
    stem = name.removesuffix(PARQUET)
    parent = "/".join(folders)
    if folders != [DATA_FOLDER]:
        for depth, folder in enumerate(folders):
            stated = _split_in(folder)
            if stated:
                return stated, "/".join(folders[: depth + 1])
    is_numbered = stem.isdigit()
    if is_numbered and parent not in ("", DATA_FOLDER):
        return folders[-1], parent  # as in the branch refs/convert/parquet of the Hub
    split = split_of_file(name)
    if split is not None:
        return split, parent
    if is_numbered or parent not in ("", DATA_FOLDER):
        return USUAL_SPLIT, parent
    return re.split("[-.]", stem)[0], parent


def _split_in(name: str) -> str:
    """Return the split that the name of a folder or file states; empty if it states none."""
    if name in _known_splits():
        return name
    words = _SEPARATORS.split(name)
    return next((_SPLIT_OF_WORD[word] for word in words if word in _SPLIT_OF_WORD), "")


@cache
def _known_splits() -> frozenset[str]:
    return frozenset(split for kind in DatasetKind.installed() for split in kind.splits)


def split_of_file(name: str) -> str | None:
    """Return the split that the name of a file states; None if it states none."""
    shard = _SHARD.fullmatch(name)
    if shard is not None:
        return shard[1]
    return _split_in(name.removesuffix(PARQUET)) or None


def splits_by_card(card: bytes, paths: Iterable[str], config: str | None, source: str) -> Splits | None:
    """Sort Parquet files by split according to the YAML of a data card; None if it does not list files.

    Parameters
    ----------
    card : bytes
        Content of ``README.md``.
    paths : iterable of str
        Paths in the folder or repository, with slashes.
    config : str or None
        Configuration to open; None for the only one or the default.
    where : str
        Its name, for messages.

    Returns
    -------
    dict of str to tuple of str, or None
        A split without files is empty. Files that the configuration does not name are left out.

    Raises
    ------
    InputError
        There are several configurations and none was chosen, none has that name, or the list of files is
        unreadable.
    """
    configs = _configurations(card, source)
    if not configs:
        return None
    chosen = configs[_chosen(list(configs), configs, config, source)]
    folder = str(chosen.get("data_dir") or "").strip("/")
    files = parquet_paths(path for path in paths if not folder or path.startswith(f"{folder}/"))
    if chosen.get("data_files") is None:
        return splits_by_name(files, source)
    patterns = _patterns(chosen["data_files"], source)
    return {
        split: tuple(dict.fromkeys(path for pattern in named for path in _matching(folder, pattern, files)))
        for split, named in patterns.items()
    }


def require_some(splits: Splits, source: str) -> Splits:
    """Return the splits of a data card; InputError if none of the files that it names is there."""
    if any(splits.values()):
        return splits
    raise errors.InputError(
        f"{_CARD} of {source!r} names the files of {', '.join(splits)}; none of them is a Parquet file there",
        next=f"correct {_CARD}, or give a Parquet file",
    )


def _configurations(card: bytes, source: str) -> dict[str, JsonObject]:
    """Return the configurations of a card by name; empty if its YAML is unreadable or lists none."""
    text = card[:_LARGEST_CARD_BYTES].decode("utf-8-sig", errors="replace").replace("\r\n", "\n")
    head = re.match(r"---[ \t]*\n(.*?)\n---[ \t]*(?:\n|$)", text, re.DOTALL)
    if head is None or "configs" not in head[1]:
        return {}
    # Imported here: it takes 15 ms, and data sets of the toolkit are opened without their card.
    import yaml

    try:
        values = yaml.safe_load(head[1])
    except (yaml.YAMLError, ValueError, RecursionError):
        return {}  # file names decide, as for a folder without a card
    if not isinstance(values, Mapping) or values.get("configs") is None:
        return {}
    listed = values["configs"]
    is_list = isinstance(listed, list) and all(isinstance(entry, Mapping) for entry in listed)
    if not is_list:
        raise _unreadable(source, "configs", "a list of configurations")
    return {str(entry.get("config_name", "default")): entry for entry in listed}


def _unreadable(source: str, field: str, expected: str) -> errors.InputError:
    return errors.InputError(
        f"{_CARD} of {source!r}: {field!r} of its YAML is not {expected}",
        next=f"correct {_CARD}",
    )


def _chosen(names: Sequence[str], configs: Mapping[str, JsonObject], config: str | None, source: str) -> str:
    """Return the configuration that `load_dataset` would choose."""
    if config is not None:
        if config in configs:
            return config
        known = f"it has {', '.join(names)}{wording.did_you_mean(config, names)}"
        raise errors.InputError(
            f"no configuration {config!r} in {source!r}: {known}", next="choose one of them"
        )
    marked = [name for name in names if name == "default" or configs[name].get("default") is True]
    candidates = marked or names
    if len(candidates) == 1:
        return candidates[0]
    raise errors.InputError(
        f"{source!r} has the configurations {', '.join(names)}; expected one of them",
        next=f"name it, config={candidates[0]!r} (in a shell --config-name {candidates[0]})",
    )


def _patterns(data_files: object, source: str) -> dict[str, list[str]]:
    """Return the patterns of the files of each split, in the order of the card."""
    expected = "a pattern, a list of patterns, or patterns by split"
    if isinstance(data_files, Mapping):
        pairs = list(data_files.items())
    elif (
        isinstance(data_files, list)
        and data_files
        and all(isinstance(entry, Mapping) for entry in data_files)
    ):
        pairs = [(entry.get("split"), entry.get("path")) for entry in data_files]
    else:
        pairs = [(USUAL_SPLIT, data_files)]
    patterns_by_split: dict[str, list[str]] = {}
    for split, named in pairs:
        patterns = named if isinstance(named, list) else [named]
        if not (isinstance(split, str) and _SPLIT_NAME.fullmatch(split)):
            raise _unreadable(source, "data_files", expected)
        if not all(isinstance(text, str) for text in patterns):
            raise _unreadable(source, "data_files", expected)
        for pattern in patterns:
            if "://" in pattern or store.problem_of_name(pattern.replace("*", "x").removeprefix("./")):
                raise errors.InputError(
                    f"{_CARD} of {source!r} names the files {pattern[:80]!r}; expected files in it",
                    next="do not use this data set, or ask who made it",
                )
        patterns_by_split.setdefault(split, []).extend(patterns)
    return patterns_by_split


def _matching(folder: str, pattern: str, paths: Sequence[str]) -> list[str]:
    whole = PurePosixPath(folder, pattern).parts
    return [path for path in paths if _matches(whole, tuple(path.split("/")))]


def _matches(pattern: tuple[str, ...], parts: tuple[str, ...]) -> bool:
    """Return whether a path matches a pattern, part by part; ``**`` matches any number of folders.

    A pattern is untrusted: unlike a regular expression, this never takes exponential time.
    """
    reached = {0}
    for number, part in enumerate(pattern):
        if part == "**":
            # At the end it matches the rest.
            reached = set(range(min(reached, default=len(parts) + 1), len(parts) + 1))
            if number == len(pattern) - 1:
                return bool(reached - {len(parts)})
            continue
        reached = {at + 1 for at in reached if at < len(parts) and fnmatchcase(parts[at], part)}
    return len(parts) in reached


def files_of_split(splits: Mapping[str, tuple[str, ...]], split: str, source: str) -> tuple[str, ...]:
    """Return the files of one split.

    Raises
    ------
    InputError
        No split has that name.
    IntegrityError
        Some of its shards, or all of its files, are missing; an incomplete split must not look complete.
    """
    if split not in splits:
        raise unknown_split(split, tuple(splits), source)
    chosen = splits[split]
    names = [store.ShardName.parse(PurePosixPath(path).name) for path in chosen]
    counts = {name.count for name in names if name is not None}
    expected = max(counts) if len(counts) == 1 and None not in names else len(chosen)
    if chosen and len(chosen) >= expected:
        return chosen
    counts_text = f"{len(chosen)} of {wording.with_count(max(expected, 1), 'files')}"
    raise errors.IntegrityError(
        f"{source!r} has {counts_text} of split {split!r}; expected all",
        next="download or generate the data set again (with a network, if it is on the Hub)",
    )


def unknown_split(split: str, known: tuple[str, ...], source: str) -> errors.InputError:
    """Return the error for a split that does not exist; ``known`` are existing ones."""
    if not known:
        return errors.InputError(
            f"no Parquet files in {source!r}", next="give the folder or repository of a data set"
        )
    known_text = f"it has {', '.join(known)}{wording.did_you_mean(split, known)}"
    return errors.InputError(
        f"no split {split!r} in {source!r}: {known_text}", next="choose one of them, or make it"
    )


def is_interrupted(folder: store.DataFolder) -> bool:
    """Return whether a folder has shard records of an unfinished run."""
    return bool(pending_shards(folder.names(PENDING_FOLDER)))


def not_a_set(folder: store.DataFolder, name: str, path: str = "") -> errors.InputError:
    """Return the error for a folder, or a file in it, without a data set; it names what was found."""
    problem, next_step = _file_in_words(path) if path else _folder_in_words(folder)
    return errors.InputError(f"{name!r} {problem}; expected a data set of Parquet files", next=next_step)


def _file_in_words(path: str) -> tuple[str, str]:
    content, _, next_step = _ENDINGS.get(_ending(path), ("a file of another kind", "", _PARQUET_STEP))
    return f"is {content}", next_step


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
            f"holds {wording.with_count(len(sets), 'data sets')} ({shown})",
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
            files += [f"{name}/{inner_name}" for inner_name in folder.names(name)]
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
    ((kind, next_step), count), *_ = sorted(counts.most_common(), key=lambda counted: counted[0] == tables)
    first = next(path for path in files if _ENDINGS.get(_ending(path), ("", "", ""))[1] == kind)
    return f"is a folder of {kind} ({count:,}, such as {first!r})", next_step


def _ending(path: str) -> str:
    return PurePosixPath(path).suffix[1:].lower()
