"""Checking the files that an index of ``frames`` or ``export`` names, and the images in them."""

from __future__ import annotations

import tarfile
from collections.abc import Callable, Iterator
from contextlib import suppress

from realtouch.convert.index_tables import files_of
from realtouch.damage import Damage
from realtouch.stored_round import stored_rows
from realtouch.tars import files_of_tar
from tactile_toolkit import read, store
from tactile_toolkit.errors import IntegrityError
from tactile_toolkit.touch import decode_image, image_size

INDEXED = ("frames", "export")
"""Operations whose rows are an index of other files."""


def check_index(
    folder: store.DataFolder,
    manifest: store.Manifest,
    findings: list[Damage],
    on_progress: Callable[[int, int], None],
    *,
    decode: bool,
) -> tuple[int, int]:
    """Add what is wrong with the files that an index names; return how many rounds and touches it has."""
    named = {finding.file for finding in findings}
    total = sum(record.rows for record in manifest.shards)
    rounds = set[str]()
    done = touches = 0
    for record in manifest.shards:
        done += record.rows
        with suppress(IntegrityError):  # an index that cannot be read is listed already
            shard = read.Shard(folder.address(record.shard.data_path))
            table = shard.read(columns=[name for name in ("round_id", "frames") if name in shard.types])
            rounds.update(table["round_id"].to_pylist())
            touches += len(table)
            if "frames" in shard.types and "touch" not in shard.types:
                # In a LeRobotDataset of single images a row is a round, and a frame is a touch.
                touches += sum(table["frames"].to_pylist()) - len(table)
            files: dict[str, str | None] = {**files_of(folder, record)}
            # The manifest lists these, so that they were compared already.
            compared = dict.fromkeys(manifest.files.keys() & files.keys())
            for path, sha256 in ({**files, **compared} or {record.shard.data_path: None}).items():
                if path not in named:
                    findings += _damage_in_file(folder, path, sha256, decode=decode)
        on_progress(done, total)
    return len(rounds), touches


def _damage_in_file(
    folder: store.DataFolder, path: str, sha256: str | None, *, decode: bool
) -> Iterator[Damage]:
    """Compare a file with its checksum, if one is given, and look at its images; yield what is wrong."""
    if sha256 is not None and not store.is_unchanged(folder, path, sha256):
        problem = f"its sha256 differs from the index, which has {sha256}"
        if not folder.exists(path):
            problem = "is missing"
        yield Damage(path, None, None, "", problem)
        return
    look: Callable[[bytes], object] = image_size
    if decode:
        look = decode_image
    try:
        for number, (name, image) in enumerate(_images_in(folder, path)):
            try:
                look(image)
            except ValueError as error:
                yield Damage(path, number, None, name, str(error))
    except tarfile.TarError as error:
        yield Damage(path, None, None, "", f"not an intact tar: {error}")


def _images_in(folder: store.DataFolder, path: str) -> Iterator[tuple[str, bytes]]:
    """Yield the images in a tar, in a column of a Parquet file that has one, or the one that a file is."""
    if path.endswith(".tar"):
        with folder.open(path) as stream:
            for member in files_of_tar(stream, folder.size_bytes(path)):
                if not member.name.endswith(".json"):
                    stream.seek(member.offset_data)
                    yield member.name, stream.read(member.size)
    elif path.endswith(".parquet"):
        shard = read.Shard(folder.address(path))
        for column in [name.removesuffix(".bytes") for name in shard.types if name.endswith(".bytes")]:
            for row in stored_rows([shard], [column]):
                yield column, row.group.table[column][row.index].as_py()["bytes"]
    elif path.endswith((".jpg", ".png")):
        yield "", folder.read_bytes(path)
