"""What a conversion must know of the shards that it reads: what identifies them, and not to write there."""

from __future__ import annotations

import hashlib
from collections.abc import Iterable
from pathlib import Path
from typing import Any

from tactile_toolkit.errors import InputError
from tactile_toolkit.read.parquet import Shard
from tactile_toolkit.store.folder import DataFolder, expanded, file_at
from tactile_toolkit.store.manifest import Manifest, read_manifest
from tactile_toolkit.store.parquet import file_sha256
from tactile_toolkit.store.shards import DATA_FOLDER

__all__ = ["content_fingerprint", "file_fingerprint", "manifest_beside", "refuse_source"]


def file_fingerprint(shard: Shard) -> dict[str, Any]:
    """Return JSON values that identify the rows of a file; its footer holds the size of every column."""
    folder, name = file_at(shard.path)
    with folder.open(name) as stream:
        # A Parquet file ends in the length of its footer and four letters.
        size = stream.seek(-8, 2) + 8
        footer_bytes = int.from_bytes(stream.read(4), "little")
        stream.seek(-8 - footer_bytes, 2)
        footer = stream.read(footer_bytes)
    return {
        "file": name,
        "rows": len(shard),
        "bytes": size,
        "footer_sha256": hashlib.sha256(footer).hexdigest(),
    }


def content_fingerprint(shard: Shard) -> dict[str, Any]:
    """Return JSON values that identify a file by all of its bytes, for sources of moderate size."""
    folder, name = file_at(shard.path)
    return {"file": name, "rows": len(shard), "sha256": file_sha256(folder, name)}


def manifest_beside(shard: Shard) -> Manifest | None:
    """Return the manifest of the folder that a shard lies in, where there is one."""
    data, _ = file_at(shard.path)
    folder, name = file_at(data.address())
    return read_manifest(folder) if name == DATA_FOLDER else None


def refuse_source(folder: DataFolder, name: str, shards: Iterable[Shard]) -> None:
    """Refuse to write where shards are read, be it by another name or through a link (InputError).

    ``name`` is the data set as the user gave it.
    """
    if not folder.is_local:
        _refuse_store_of_source(folder, name, shards)
        return
    out = Path(folder.address()).resolve()
    home = expanded(name).resolve()
    files = [Path(shard.path).absolute() for shard in shards]
    # By both paths: files of the Hub's cache are links into another folder.
    real = [file.resolve() for file in files]
    if any(file.is_relative_to(out) for file in real):
        found = "holds the source"
    elif home.is_dir() and out.is_relative_to(home) and any(f.is_relative_to(home) for f in [*real, *files]):
        found = "lies in the source"
    else:
        return
    message = (
        f"{folder.address()!r}, the folder to write, {found} {name!r}; nothing was changed; next: "
        "choose a folder outside it"
    )
    raise InputError(message)


def _refuse_store_of_source(folder: DataFolder, name: str, shards: Iterable[Shard]) -> None:
    files = [shard.path for shard in shards]
    inside = f"{folder.address()}/"
    if any(file.startswith(inside) for file in files) or inside.startswith(f"{name.rstrip('/')}/"):
        message = (
            f"{folder.address()!r}, the folder to write, holds or lies in the source {name!r}; "
            "nothing was changed; next: choose another folder"
        )
        raise InputError(message)
