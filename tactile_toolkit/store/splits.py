"""Parquet files by the split that they belong to, as their names tell."""

from __future__ import annotations

import re
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import PurePosixPath

from tactile_toolkit.errors import InputError, IntegrityError
from tactile_toolkit.store.shards import DATA_FOLDER, ShardName

__all__ = ["ShardFile", "files_of_split", "no_split", "shard_files"]


@dataclass(frozen=True, slots=True, order=True)
class ShardFile:
    """A Parquet file and the split that it belongs to by its name."""

    split: str
    path: str


def shard_files(paths: Iterable[str]) -> list[ShardFile]:
    """Sort Parquet files by split: ``train-00000-of-00002.parquet``, or a split's bare name.

    Files that are only numbered, as in the Hub's own conversions (``default/train/0000.parquet``), belong to
    the split that their folder is called.
    """
    files = []
    for path in paths:
        file = PurePosixPath(path)
        if file.suffix != ".parquet" or file.name.startswith(".") or file.parts[0] == "reports":
            continue
        shard = ShardName.parse(file.name)
        files.append(ShardFile(shard.split if shard else _split_of(file), path))
    return sorted(files)


def _split_of(file: PurePosixPath) -> str:
    word = re.split(r"[-.]", file.name)[0]
    return file.parent.name if word.isdigit() and file.parent.name not in ("", DATA_FOLDER) else word


def files_of_split(files: list[ShardFile], split: str, where: str) -> list[ShardFile]:
    """Return the files of one split.

    Raises
    ------
    InputError
        There is no such split.
    IntegrityError
        Some of its shards are absent.
    """
    chosen = [file for file in files if file.split == split]
    if not chosen:
        raise no_split(split, tuple(dict.fromkeys(file.split for file in files)), where)
    _refuse_missing_shards(chosen, where)
    return chosen


def _refuse_missing_shards(files: list[ShardFile], where: str) -> None:
    """Refuse a split of which some shards are absent: fewer rows than there should be must not pass."""
    names = [ShardName.parse(PurePosixPath(file.path).name) for file in files]
    counts = {name.count for name in names if name is not None}
    if len(counts) == 1 and None not in names and len(files) < max(counts):
        message = (
            f"{len(files)} of {max(counts)} shards of split {files[0].split!r} are in {where!r}, all were "
            "expected; next: download or generate the data set again (with a network, if it is on the Hub)"
        )
        raise IntegrityError(message)


def no_split(split: str, known: tuple[str, ...], where: str) -> InputError:
    """Return the error for a split that is not there, among those that are."""
    found = f"it has {', '.join(known)}" if known else "it holds no Parquet files"
    return InputError(f"no split {split!r} in {where!r}: {found}; next: choose one of them, or make it")
