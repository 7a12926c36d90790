"""Checking every file and every round of a data set."""

from __future__ import annotations

import re
import tarfile
from collections.abc import Callable, Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace

from realtouch.columns import Damage, TouchRow, stored_rows
from realtouch.convert.plan import files_of
from realtouch.integrity import (
    agreeing_files,
    checked_rows,
    modal_touch_count,
    stated_class_names,
)
from realtouch.kind import KIND
from realtouch.tars import files_of_tar
from tactile_toolkit import cards, places, read, store
from tactile_toolkit.errors import InputError, IntegrityError
from tactile_toolkit.touch import decode_image, image_size


@dataclass(frozen=True, slots=True)
class TouchVerification:
    """Result of :func:`verify`; empty ``findings`` means that everything can be used.

    Attributes
    ----------
    rounds, touches : int
        How many were checked.
    findings : tuple of Damage
        All that is wrong.
    unprotected : tuple of str
        Files of which nothing says what they should be: their pages carry no checksums, and neither a
        manifest nor the Hub gave one. A number that was changed in them since then shows nowhere.
    """

    rounds: int
    touches: int
    findings: tuple[Damage, ...]
    unprotected: tuple[str, ...] = ()

    @property
    def ok(self) -> bool:
        """Whether nothing is wrong."""
        return not self.findings


def verify(
    name: places.Name | places.Place | Sequence[places.Name],
    split: str | None = None,
    *,
    quick: bool = False,
    workers: int = 1,
    on_progress: Callable[[int, int], None] = lambda _done, _total: None,
) -> TouchVerification:
    """Check every file, round, touch and frame of a data set, and list all that is wrong.

    Of an unfinished set, all finished shards are checked.

    Parameters
    ----------
    name : str, path, or sequence of them
        What :func:`realtouch.load` opens.
    split : str, optional
        Only this split; all of a folder, or train and test, by default.
    quick : bool
        Read the headers of images and frames instead of decoding them.
    workers : int
        Number of threads that read and decode; what is found does not depend on it.
    on_progress : callable
        Called with the number of rounds checked so far and the number in all.

    Raises
    ------
    InputError
        Nothing of that name, or no data set of touches.
    """
    place = replace(places.open_place(name), allow_incomplete=True).require(KIND, "verify")
    folder, manifest = place.folder, place.manifest
    # Files of a folder of ours are held against its manifest and card, others against what the Hub said.
    has_checksums = folder is not None and (manifest is not None or store.read_record(folder) is not None)
    findings: list[Damage] = []
    if folder is not None and has_checksums:
        listed = store.verify(folder, check_card=cards.check_card, workers=workers).findings
        findings += [Damage(each.file, None, None, "", each.problem) for each in listed]
    if folder is not None and manifest is not None:
        operation = manifest.spec.get("operation")
        if operation in ("frames", "export"):
            if not manifest.complete:  # the index is written last
                return TouchVerification(0, 0, tuple(findings))
            return _verify_index(folder, manifest, findings, on_progress, decode=not quick)
        try:
            store.convert_json(operation, str, store.MANIFEST_FILE, "spec.operation")
        except IntegrityError as error:
            findings.append(Damage(store.MANIFEST_FILE, None, None, "", str(error)))
    parts = (split,) if split is not None else place.splits
    splits = []
    for part in parts:
        splits.append(agreeing_files(place.shards(part), place.name, findings))
        findings += _lacking_columns(splits[-1])
    shards = [shard for files in splits for shard in files]
    total, rounds, touches = sum(map(len, shards)), 0, 0
    seen: dict[str, str] = {}
    for files in splits:
        expected, names = modal_touch_count(files), stated_class_names(files)
        for row, problems in checked_rows(
            read.row_groups(files), expected, names, decode=not quick, workers=workers
        ):
            findings += problems
            if row is not None:
                rounds += 1
                findings += _repeated_id(row, seen)
                with suppress(InputError, IntegrityError):
                    touches += row.touch_total()
                on_progress(rounds, total)
    fetched = place.fetched_paths()  # compared when they came
    unprotected = [
        shard.path
        for shard in shards
        if not (has_checksums or shard.path in fetched)
        and not has_page_checksums(*store.split_uri(shard.path))
    ]
    return TouchVerification(rounds, touches, tuple(findings), tuple(unprotected))


def check_folder(folder: store.DataFolder, workers: int = 1) -> list[store.Finding]:
    """List what is wrong with a folder before it goes to others; decodes no picture."""
    found = verify(folder.address(), quick=True, workers=workers).findings
    return (
        [store.Finding(damage.file, f"({damage})") for damage in found]
        if found
        else list(cards.check_card(folder))
    )


def _verify_index(
    folder: store.DataFolder,
    manifest: store.Manifest,
    findings: list[Damage],
    on_progress: Callable[[int, int], None],
    *,
    decode: bool,
) -> TouchVerification:
    """Check the files that the index of ``frames`` or ``export`` names, and the images in them."""
    named = {finding.file for finding in findings}
    total = sum(record.rows for record in manifest.shards)
    rounds = set[str]()
    done = touches = 0
    for record in manifest.shards:
        done += record.rows
        with suppress(IntegrityError):  # an index that cannot be read is named already
            shard = read.Shard(folder.address(record.shard.data_path))
            table = shard.read(columns=[name for name in ("round_id", "frames") if name in shard.types])
            rounds.update(table["round_id"].to_pylist())
            # Of a LeRobotDataset of single images a row is a round, and a frame is a touch.
            is_round = "frames" in shard.types and "touch" not in shard.types
            touches += sum(table["frames"].to_pylist()) if is_round else len(table)
            files = files_of(folder, record) or {record.shard.data_path: record.sha256}
            for path, sha256 in files.items():
                # Files that the manifest lists were compared with it.
                is_compared = path in (manifest.files or ()) or path == record.shard.data_path
                if path not in named:
                    findings += _damage_in_file(folder, path, None if is_compared else sha256, decode=decode)
        on_progress(done, total)
    return TouchVerification(len(rounds), touches, tuple(findings))


def _damage_in_file(
    folder: store.DataFolder, path: str, sha256: str | None, *, decode: bool
) -> Iterator[Damage]:
    """Compare a file with its checksum, if one is given, and look at its images; yield what is wrong."""
    if sha256 is not None and not store.is_unchanged(folder, path, sha256):
        problem = f"its sha256 differs from the index, which has {sha256}"
        yield Damage(path, None, None, "", problem if folder.exists(path) else "is missing")
        return
    look = decode_image if decode else image_size
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


def _lacking_columns(shards: Sequence[read.Shard]) -> list[Damage]:
    """List the columns that some files of a split have and others do not: they can be read of no row."""
    names = {shard.path: read.column_names(shard.schema) for shard in shards}
    known = dict.fromkeys(name for columns in names.values() for name in columns)
    problem = "the column is not there; expected it as in other files of the split"
    return [
        Damage(path, None, None, name, problem)
        for path, columns in names.items()
        for name in known
        if name not in columns
    ]


def _repeated_id(row: TouchRow, seen: dict[str, str]) -> list[Damage]:
    try:
        name = row.name()
    except (InputError, IntegrityError):  # there are none, or it is named with the other fields
        return []
    here = f"{row.path!r}, row {row.number}"
    first = seen.setdefault(name, here)
    if first == here:
        return []
    return [Damage(row.path, row.number, None, "id", f"{name!r} is not unique, it also stands in {first}")]


def has_page_checksums(folder: store.DataFolder, path: str) -> bool:
    """Return whether the pages of a Parquet file carry checksums, by the first page of each column.

    Raises IntegrityError when the file is damaged.
    """
    footer = store.open_parquet(folder, path).metadata
    columns = [
        footer.row_group(group).column(index)
        for group in range(footer.num_row_groups)
        for index in range(footer.num_columns)
    ]
    starts = [
        min(filter(None, (column.dictionary_page_offset, column.data_page_offset)))
        for column in columns
        if column.num_values
    ]
    with folder.open(path) as stream:
        return all(stream.seek(start) and _CHECKED_PAGE.match(stream.read(32)) for start in starts)


# How the head of a page with a checksum begins: four integers (type, two sizes, the checksum), each after the
# mark of a field that follows on the one before it (Thrift's compact protocol).
_CHECKED_PAGE = re.compile(rb"(?:\x15[\x80-\xff]*[\x00-\x7f]){4}", re.DOTALL)
