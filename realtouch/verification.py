"""Checking every file and every round of a data set."""

from __future__ import annotations

import re
import tarfile
from collections.abc import Callable, Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace

from realtouch import convert, integrity, kind, stored_columns, stored_round, tars
from tactile_toolkit import cards, errors, places, read, store, touch

INDEXED = ("frames", "export")
"""Operations whose rows are an index of other files."""

# How the head of a page with a checksum begins: four integers (type, two sizes, the checksum), each after the
# mark of a field that follows on the one before it (Thrift's compact protocol).
_CHECKED_PAGE = re.compile(rb"(?:\x15[\x80-\xff]*[\x00-\x7f]){4}", re.DOTALL)


def check_index(
    folder: store.DataFolder,
    manifest: store.Manifest,
    findings: list[stored_columns.Damage],
    on_progress: Callable[[int, int], None],
    *,
    decode: bool,
) -> tuple[int, int]:
    """Add the damage of the files of an index; return its numbers of rounds and touches."""
    named = {finding.file for finding in findings}
    total = sum(record.rows for record in manifest.shards)
    rounds = set[str]()
    done = touches = 0
    for record in manifest.shards:
        done += record.rows
        with suppress(errors.IntegrityError):  # an index that cannot be read is listed already
            shard = read.Shard(folder.address(record.shard.data_path))
            table = shard.read(columns=[name for name in ("round_id", "frames") if name in shard.types])
            rounds.update(table["round_id"].to_pylist())
            touches += len(table)
            if "frames" in shard.types and "touch" not in shard.types:
                # In a LeRobotDataset of single images a row is a round, and a frame is a touch.
                touches += sum(table["frames"].to_pylist()) - len(table)
            files: dict[str, str | None] = {**convert.files_of(folder, record)}
            # The manifest lists these, so they have been compared already.
            compared = dict.fromkeys(manifest.files.keys() & files.keys())
            for path, sha256 in ({**files, **compared} or {record.shard.data_path: None}).items():
                if path not in named:
                    findings += _damage_in_file(folder, path, sha256, decode=decode)
        on_progress(done, total)
    return len(rounds), touches


def _damage_in_file(
    folder: store.DataFolder, path: str, sha256: str | None, *, decode: bool
) -> Iterator[stored_columns.Damage]:
    """Compare a file with its checksum, if given, and check its images; yield the damage."""
    if sha256 is not None and not folder.has_sha256(path, sha256):
        problem = f"its sha256 differs from the index, which has {sha256}"
        if not folder.exists(path):
            problem = "is missing"
        yield stored_columns.Damage(path, None, None, "", problem)
        return
    look: Callable[[bytes], object] = touch.image_size
    if decode:
        look = touch.decode_image
    try:
        for number, (name, image) in enumerate(_images_in(folder, path)):
            try:
                look(image)
            except ValueError as error:
                yield stored_columns.Damage(path, number, None, name, str(error))
    except tarfile.TarError as error:
        yield stored_columns.Damage(path, None, None, "", f"not an intact tar: {error}")


def _images_in(folder: store.DataFolder, path: str) -> Iterator[tuple[str, bytes]]:
    """Yield the images of a tar, of the columns of a Parquet file, or of an image file."""
    if path.endswith(".tar"):
        with folder.open(path) as stream:
            for member in tars.files_of_tar(stream, folder.size_bytes(path)):
                if not member.name.endswith(".json"):
                    stream.seek(member.offset_data)
                    yield member.name, stream.read(member.size)
    elif path.endswith(".parquet"):
        shard = read.Shard(folder.address(path))
        for column in [name.removesuffix(".bytes") for name in shard.types if name.endswith(".bytes")]:
            for row in stored_round.stored_rows([shard], [column]):
                yield column, row.group.table[column][row.index].as_py()["bytes"]
    elif path.endswith((".jpg", ".png")):
        yield "", folder.read_bytes(path)


@dataclass(frozen=True, slots=True)
class TouchVerification:
    """Result of :func:`verify`; without ``findings`` everything can be used.

    Attributes
    ----------
    rounds, touches : int
        How many were checked.
    findings : tuple of Damage
        All that is wrong.
    unprotected : tuple of str
        Files without any checksum: neither their pages nor a manifest nor the Hub have one. A changed number
        in them cannot be noticed.
    """

    rounds: int
    touches: int
    findings: tuple[stored_columns.Damage, ...]
    unprotected: tuple[str, ...] = ()

    @property
    def ok(self) -> bool:
        """Whether there are no findings."""
        return not self.findings


def verify(
    name: places.Name | places.Place | Sequence[places.Name],
    split: str | None = None,
    *,
    quick: bool = False,
    workers: int = 1,
    on_progress: Callable[[int, int], None] = lambda _done, _total: None,
) -> TouchVerification:
    """Check every file, round, touch and frame of a data set, and list all damage.

    In an unfinished set, only the finished shards are checked.

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
    place = replace(places.open_place(name), allow_incomplete=True).require(kind.KIND, "verify")
    findings: list[stored_columns.Damage] = []
    has_checksums = _compare_files(place, findings, workers)
    if place.folder is not None and place.manifest is not None and place.spec.get("operation") in INDEXED:
        counts = (0, 0)
        if place.manifest.complete:  # the index is written last
            counts = check_index(place.folder, place.manifest, findings, on_progress, decode=not quick)
        return TouchVerification(*counts, tuple(findings))
    splits = []
    for part in convert.parts_of(place, split):
        splits.append(integrity.agreeing_files(place.shards(part), place.name, findings))
        findings += _lacking_columns(splits[-1])
    rounds, touches = _check_rounds(splits, findings, on_progress, decode=not quick, workers=workers)
    unprotected: list[str] = []
    if not has_checksums:
        fetched = place.fetched_paths()  # compared when they were fetched
        paths = [shard.path for files in splits for shard in files if shard.path not in fetched]
        unprotected = [path for path in paths if not has_page_checksums(*store.split_uri(path))]
    return TouchVerification(rounds, touches, tuple(findings), tuple(unprotected))


def _compare_files(place: places.Place, findings: list[stored_columns.Damage], workers: int) -> bool:
    """Compare the files of a folder with its manifest or download record; return whether it has one."""
    folder, manifest = place.folder, place.manifest
    if folder is None or (manifest is None and store.read_download_record(folder) is None):
        return False
    listed = store.verify(folder, check_card=cards.check_card, workers=workers).findings
    findings += [stored_columns.Damage(each.file, None, None, "", each.problem) for each in listed]
    if manifest is not None:
        try:
            store.convert_json(place.spec.get("operation"), str, store.MANIFEST_FILE, "spec.operation")
        except errors.IntegrityError as error:
            findings.append(stored_columns.Damage(store.MANIFEST_FILE, None, None, "", str(error)))
    return True


def _check_rounds(
    splits: Sequence[Sequence[read.Shard]],
    findings: list[stored_columns.Damage],
    on_progress: Callable[[int, int], None],
    *,
    decode: bool,
    workers: int,
) -> tuple[int, int]:
    """Add the damage of the rounds of all splits; return the numbers of rounds and touches read."""
    total = sum(len(shard) for files in splits for shard in files)
    rounds = touches = 0
    seen: dict[str, str] = {}
    for files in splits:
        expected, names = integrity.modal_touch_count(files), integrity.stated_class_names(files)
        for row, problems in integrity.checked_rows(
            read.row_groups(files), expected, names, decode=decode, workers=workers
        ):
            findings += problems
            if row is not None:
                rounds += 1
                findings += _repeated_id(row, seen)
                with suppress(errors.InputError, errors.IntegrityError):
                    touches += row.touch_total()
                on_progress(rounds, total)
    return rounds, touches


def list_findings(folder: store.DataFolder, workers: int = 1) -> list[store.Finding]:
    """List the problems of a folder before it is uploaded; decodes no picture."""
    found = verify(folder.address(), quick=True, workers=workers).findings
    return [store.Finding(damage.file, f"({damage})") for damage in found] or list(cards.check_card(folder))


def _lacking_columns(shards: Sequence[read.Shard]) -> list[stored_columns.Damage]:
    """List the columns that some files of a split lack; they cannot be read from the whole split."""
    names = {shard.path: read.column_names(shard.schema) for shard in shards}
    known = dict.fromkeys(name for columns in names.values() for name in columns)
    problem = "the column is not there; expected it as in other files of the split"
    return [
        stored_columns.Damage(path, None, None, name, problem)
        for path, columns in names.items()
        for name in known
        if name not in columns
    ]


def _repeated_id(row: stored_round.StoredRound, seen: dict[str, str]) -> list[stored_columns.Damage]:
    try:
        name = row.name()
    except (errors.InputError, errors.IntegrityError):
        return []  # no column of ids, or an id that is listed with the other fields
    here = f"{row.path!r}, row {row.number}"
    first = seen.setdefault(name, here)
    if first == here:
        return []
    return [
        stored_columns.Damage(
            row.path, row.number, None, "id", f"{name!r} is not unique, it is also the id in {first}"
        )
    ]


def has_page_checksums(folder: store.DataFolder, path: str) -> bool:
    """Return whether the pages of a Parquet file carry checksums, by the first page of each column.

    Raises IntegrityError when the file is damaged.
    """
    columns = read.Shard(folder.address(path)).column_chunks()
    starts = [
        min(filter(None, (column.dictionary_page_offset, column.data_page_offset)))
        for column in columns
        if column.num_values
    ]
    with folder.open(path) as stream:
        return all(stream.seek(start) and _CHECKED_PAGE.match(stream.read(32)) for start in starts)
