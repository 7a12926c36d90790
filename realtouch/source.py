"""What a conversion reads: the splits of a data set, their fingerprint, and where none may be written."""

from __future__ import annotations

import hashlib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from os import PathLike, fspath
from pathlib import Path
from typing import Any

from dataset_store.errors import InputError
from dataset_store.places import splits_of
from dataset_store.rowgroups import Shard
from dataset_store.storage import DataFolder
from realtouch.names import repository_of
from realtouch.opening import open_shards
from realtouch.schema import Kind, class_names, kind_of, require_types

__all__ = ["Source", "refuse_source"]


@dataclass(frozen=True)
class Source:
    """A data set to convert.

    Attributes
    ----------
    name : str
        Folder, file, short name or Hub repository, as the user gave it.
    shards : mapping of str to tuple of Shard
        Shards of each split.
    kind : "seq" or "single"
        What it holds.
    """

    name: str
    shards: Mapping[str, tuple[Shard, ...]]
    kind: Kind

    @classmethod
    def open(cls, name: str | PathLike[str], revision: str | None = None, split: str | None = None) -> Source:
        """Find the splits of a data set, fetching them first where they are on the Hub; read their footers.

        Parameters
        ----------
        name : str or path
            Folder, file, short name or Hub repository.
        revision : str, optional
            Branch, tag or commit of a Hub repository.
        split : str, optional
            Only this split, of which alone files are fetched; all by default.

        Raises
        ------
        InputError, IntegrityError, HubError
            As :func:`realtouch.load`.
        """
        name = fspath(name)
        splits = (split,) if split is not None else splits_of(repository_of(name), revision=revision)
        shards = {each: open_shards(name, each, revision=revision) for each in splits}
        for shard in (shard for found in shards.values() for shard in found):
            require_types(shard.schema, shard.path)
        return cls(name, shards, kind_of(shards[splits[0]][0].schema, name))

    @property
    def schema(self) -> Any:
        """Arrow schema of the first shard."""
        return next(iter(self.shards.values()))[0].schema

    @property
    def label_names(self) -> tuple[str, ...]:
        """Name of each class."""
        return class_names(self.schema)

    def row_bytes(self) -> int:
        """Return the size of a row unpacked, on average over the data set."""
        shards = [shard for found in self.shards.values() for shard in found]
        groups = [
            shard.metadata.row_group(index)
            for shard in shards
            for index in range(shard.metadata.num_row_groups)
        ]
        rows = sum(group.num_rows for group in groups)
        return int(sum(group.total_byte_size for group in groups) // max(rows, 1))

    def fingerprint(self) -> dict[str, list[dict[str, Any]]]:
        """Return JSON values that identify the rows: names, sizes and footers of the files."""
        return {split: [_file_fingerprint(shard) for shard in found] for split, found in self.shards.items()}


def _file_fingerprint(shard: Shard) -> dict[str, Any]:
    # The footer holds place and size of every column chunk: other content gives another footer, and reading
    # 28 GB to plan a conversion would cost minutes.
    with Path(shard.path).open("rb") as stream:
        stream.seek(-8, 2)
        footer_bytes = int.from_bytes(stream.read(4), "little")
        stream.seek(-8 - footer_bytes, 2)
        footer = stream.read(footer_bytes)
    size = Path(shard.path).stat().st_size
    return {
        "file": Path(shard.path).name,
        "rows": len(shard),
        "bytes": size,
        "footer_sha256": hashlib.sha256(footer).hexdigest(),
    }


def refuse_source(folder: DataFolder, source: Source) -> None:
    """Refuse to write where the source is read, be it by another name or through a link.

    Raises
    ------
    InputError
        The folder holds a file of the source, or lies in its folder.
    """
    if not folder.is_local:
        return
    out = Path(folder.address()).resolve()
    home = Path(source.name).expanduser().resolve()
    files = [Path(shard.path).absolute() for shards in source.shards.values() for shard in shards]
    real = [file.resolve() for file in files]
    if _any_below(out, real):
        found = "holds the source"
    elif home.is_dir() and out.is_relative_to(home) and _any_below(home, [*real, *files]):
        found = "lies in the source"
    else:
        return
    message = (
        f"{folder.address()!r}, the folder to write, {found} {source.name!r}; nothing was changed; next: "
        "choose a folder outside it"
    )
    raise InputError(message)


def _any_below(folder: Path, files: Sequence[Path]) -> bool:
    return any(file.is_relative_to(folder) for file in files)
