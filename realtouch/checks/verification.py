"""Checking every file and every round of a data set."""

from __future__ import annotations

import re
import tarfile
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import AbstractContextManager, contextmanager, suppress
from dataclasses import dataclass, replace
from functools import partial

from realtouch import kind
from realtouch.convert import conversion, picture_files
from realtouch.touches import damage, loading, media, schema, stored_round, stored_values
from tactile_toolkit import cards, errors, places, read, run, store, wording
from tactile_toolkit.touch import EncodedImage, decode_image

# How the head of a page with a checksum begins: four integers (type, two sizes, the checksum), each after the
# mark of a field that follows on the one before it (Thrift's compact protocol).
_CHECKED_PAGE = re.compile(rb"(?:\x15[\x80-\xff]*[\x00-\x7f]){4}", re.DOTALL)

_Noted = Callable[[], AbstractContextManager[None]]


def check_index(
    folder: store.DataFolder,
    manifest: store.Manifest,
    findings: list[damage.Damage],
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
            files: dict[str, str | None] = {**conversion.files_of(folder, record.file)}
            # The manifest lists these, so they have been compared already.
            compared = dict.fromkeys(manifest.files.keys() & files.keys())
            for path, sha256 in ({**files, **compared} or {record.shard.data_path: None}).items():
                if path not in named:
                    findings += _damage_in_file(folder, path, sha256, decode=decode)
        on_progress(done, total)
    return len(rounds), touches


def _damage_in_file(
    folder: store.DataFolder, path: str, sha256: str | None, *, decode: bool
) -> Iterator[damage.Damage]:
    """Compare a file with its checksum, if given, and check its images; yield the damage."""
    if sha256 is not None and not folder.has_sha256(path, sha256):
        problem = f"its sha256 differs from the index, which has {sha256}"
        if not folder.exists(path):
            problem = "is missing"
        yield damage.Damage(path, None, None, "", problem)
        return
    try:
        for number, (name, image) in enumerate(_images_in(folder, path)):
            try:
                decode_image(image) if decode else EncodedImage(image).size()
            except ValueError as error:
                yield damage.Damage(path, number, None, name, str(error))
    except tarfile.TarError as error:
        yield damage.Damage(path, None, None, "", f"not an intact tar: {error}")


def _images_in(folder: store.DataFolder, path: str) -> Iterator[tuple[str, bytes]]:
    """Yield the images of a tar, of the columns of a Parquet file, or of an image file."""
    if path.endswith(".tar"):
        with folder.open(path) as stream:
            for member in picture_files.files_of_tar(stream, folder.size_bytes(path)):
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
    findings: tuple[damage.Damage, ...]
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
    data_set = replace(places.open_place(name), allow_incomplete=True).require(kind.KIND, "realtouch.verify")
    findings: list[damage.Damage] = []
    has_checksums = _compare_files(data_set, findings, workers)
    if (
        data_set.folder is not None
        and data_set.manifest is not None
        and data_set.spec.get("operation") == "export"  # its rows are an index of other files
    ):
        counts = (0, 0)
        if data_set.manifest.complete:  # the index is written last
            counts = check_index(data_set.folder, data_set.manifest, findings, on_progress, decode=not quick)
        return TouchVerification(*counts, tuple(findings))
    splits = []
    for part in loading.parts_of(data_set, split):
        splits.append(loading.agreeing_files(data_set.shards(part), data_set.name, findings))
        findings += _lacking_columns(splits[-1])
    rounds, touches = _check_rounds(splits, findings, on_progress, decode=not quick, workers=workers)
    unprotected: list[str] = []
    if not has_checksums:
        fetched = data_set.fetched_paths()  # compared when they were fetched
        paths = [shard.path for files in splits for shard in files if shard.path not in fetched]
        unprotected = [path for path in paths if not has_page_checksums(*store.split_uri(path))]
    return TouchVerification(rounds, touches, tuple(findings), tuple(unprotected))


def _compare_files(data_set: places.Place, findings: list[damage.Damage], workers: int) -> bool:
    """Compare the files of a folder with its manifest or download record; return whether it has one."""
    folder, manifest = data_set.folder, data_set.manifest
    if folder is None or (manifest is None and data_set.download is None):
        return False
    listed = cards.verify(folder, workers=workers).findings
    findings += [damage.Damage(finding.file, None, None, "", finding.problem) for finding in listed]
    if manifest is not None:
        try:
            manifest.operation(store.MANIFEST_FILE)
        except errors.IntegrityError as error:
            findings.append(damage.Damage(store.MANIFEST_FILE, None, None, "", str(error)))
    return True


def _check_rounds(
    splits: Sequence[Sequence[read.Shard]],
    findings: list[damage.Damage],
    on_progress: Callable[[int, int], None],
    *,
    decode: bool,
    workers: int,
) -> tuple[int, int]:
    """Add the damage of the rounds of all splits; return the numbers of rounds and touches read."""
    total = sum(len(shard) for files in splits for shard in files)
    rounds = touches = 0
    first_rows: dict[str, str] = {}
    for files in splits:
        expected = modal_touch_count(files)
        names = schema.stated_class_names(files)
        for row, problems in checked_rows(files, expected, names, decode=decode, workers=workers):
            findings += problems
            if row is not None:
                rounds += 1
                findings += _repeated_id(row, first_rows)
                with suppress(errors.InputError, errors.IntegrityError):
                    touches += row.touch_total()
                on_progress(rounds, total)
    return rounds, touches


def list_findings(folder: store.DataFolder, workers: int = 1) -> tuple[damage.Damage, ...]:
    """List the problems of a folder before it is uploaded; decodes no picture."""
    return verify(folder.address(), quick=True, workers=workers).findings


def _lacking_columns(shards: Sequence[read.Shard]) -> list[damage.Damage]:
    """List the columns that some files of a split lack; they cannot be read from the whole split."""
    names = {
        shard.path: (*read.column_names(shard.schema), *(shard.absent_columns or ())) for shard in shards
    }
    known = dict.fromkeys(name for columns in names.values() for name in columns)
    problem = "the column is not there; expected it as in other files of the split"
    return [
        damage.Damage(path, None, None, name, problem)
        for path, columns in names.items()
        for name in known
        if name not in columns
    ]


def _repeated_id(row: stored_round.StoredRound, first_rows: dict[str, str]) -> list[damage.Damage]:
    try:
        name = row.name()
    except (errors.InputError, errors.IntegrityError):
        return []  # no column of ids, or an id that is listed with the other fields
    here = f"{row.path!r}, row {row.number}"
    first = first_rows.setdefault(name, here)
    if first == here:
        return []
    return [
        damage.Damage(
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


def modal_touch_count(shards: Sequence[read.Shard]) -> int | None:
    """Return the T that every round of a data set must have: the T of more than half of its readable rounds.

    None if rounds may differ: if there is no such T, or if the set has a manifest. Imported and selected
    rounds differ in length, and the manifest has their checksums.
    """
    if shards and shards[0].manifest() is not None:
        return None
    counts: Counter[int] = Counter()
    for shard in shards:
        for index in range(len(shard.group_starts) - 1):
            with suppress(errors.IntegrityError):
                counts.update(stored_values.touch_counts(shard, index).tolist())
    return next((count for count, rounds in counts.items() if 2 * rounds > counts.total()), None)


def checked_rows(
    shards: Iterable[read.Shard],
    expected_touches: int | None,
    class_names: Sequence[str] | None,
    *,
    decode: bool = True,
    workers: int = 1,
) -> Iterator[tuple[stored_round.StoredRound | None, list[damage.Damage]]]:
    """Yield all rows of files with the faults of each; None for unreadable rows.

    Arguments are as for :func:`check_round`; the result does not depend on the number of threads.
    """

    def checked(
        row: stored_round.StoredRound | damage.Damage,
    ) -> tuple[stored_round.StoredRound | None, list[damage.Damage]]:
        if isinstance(row, damage.Damage):
            return None, [row]
        return row, check_round(row, expected_touches, decode=decode, class_names=class_names)

    return run.in_threads(checked, readable_rows(shards), workers)


def readable_rows(
    shards: Iterable[read.Shard],
) -> Iterator[stored_round.StoredRound | damage.Damage]:
    """Yield all rows; the damage stands for rows that cannot be read."""
    for shard in shards:
        for index in range(len(shard.group_starts) - 1):
            try:
                yield from stored_round.rows_of(shard.blocks(index))
            except errors.IntegrityError as error:
                yield damage.unreadable_rows(shard, index, error)


def check_round(
    row: stored_round.StoredRound,
    expected_touches: int | None = None,
    *,
    decode: bool = True,
    class_names: Sequence[str] | None = None,
) -> list[damage.Damage]:
    """List the damage of one round: one entry per field of it, and one per field of each touch.

    ``expected_touches`` is the T that it must have, where that is known; the label must be one of
    ``class_names``, where those are stated. Without ``decode``, only headers of images and frames are read.
    """
    damages: list[damage.Damage] = []
    noted = partial(_noted, damages, row)
    scalars: dict[str, Callable[[], object]] = {
        "id": row.name,
        "object_id": partial(row.integer, "object_id"),
        "label": partial(row.label_value, class_names),
    }
    checks = [row.read_info] if row.has_info() else list[Callable[[], object]]()
    for check in [*checks, *(scalars[name] for name in filter(row.has, scalars))]:
        with noted():
            check()
    for name in schema.per_touch_columns(row.group.names):
        with noted():
            # A list of fixed length would hide a null.
            if not row.group.arrow(name)[row.index].is_valid:
                raise row.damaged(name, "no values are stored")
            row.entries_of(name)
        if damages and damages[-1].field == "pos_in_cell":
            return damages  # the number of touches is unknown
    count = row.touch_total()
    if expected_touches is not None and count != expected_touches:
        damages.append(
            damage.Damage(
                row.path,
                row.number,
                None,
                "pos_in_cell",
                f"{wording.with_count(count, 'touches')}; expected {expected_touches} as in the other rounds",
            )
        )
    for name in schema.extra_columns(row.group.names):
        with noted():
            row.extra_values(name)
    sizes = _check_touches(row, count, noted, decode=decode)
    # Several fields may report the same fault.
    return list(dict.fromkeys([*damages, *_odd_sizes(row, sizes, row.media_column)]))


def _check_touches(
    row: stored_round.StoredRound, count: int, noted: _Noted, *, decode: bool
) -> dict[int, tuple[int, ...]]:
    """Check position, pose and picture of each touch; return height and width of the pictures."""
    is_clip = row.kind == "seq"
    read_pose: Callable[[int], object] = row.pose_sequences if is_clip else row.poses
    start, stop = row.column_of(row.media_column).inside(0, row.index, row.index + 1)
    sizes: dict[int, tuple[int, ...]] = {}
    for touch in range(count):
        if row.has("pos_in_cell"):
            with noted():
                row.intended_positions(touch)
        if row.has_poses and row.has(f"{schema.POSE_COLUMN[row.kind]}.quaternion"):
            with noted():
                read_pose(touch)
        if touch < stop - start:  # if images or clips are missing, the others are checked
            with noted():
                if is_clip:
                    sizes[touch] = _clip_size(row, touch, noted, decode=decode)
                else:
                    with row.naming("sensor_image", touch):
                        sizes[touch] = _size_of(media.SensorImages(row).encoded(touch), decode=decode)
    return sizes


@contextmanager
def _noted(damages: list[damage.Damage], row: stored_round.StoredRound) -> Iterator[None]:
    """Add the damage to a list instead of raising it."""
    try:
        yield
    except damage.DamagedRoundError as error:
        damages.append(error.damage)
    except (errors.InputError, errors.IntegrityError) as error:
        damages.append(damage.Damage(row.path, row.number, None, "", error.what))
    except ValueError as error:
        damages.append(damage.Damage(row.path, row.number, None, "", str(error)))


def _size_of(data: bytes | memoryview, *, decode: bool) -> tuple[int, ...]:
    """Return height and width of an image."""
    return decode_image(data).shape[:2] if decode else EncodedImage(data).size()


def _clip_size(row: stored_round.StoredRound, touch: int, noted: _Noted, *, decode: bool) -> tuple[int, ...]:
    """Return height and width of all frames of a clip; empty for a clip without frames."""
    clip = media.TouchClip(row, touch)
    with noted():
        if row.has("touch_start_time_rel") and row.has("touch_end_time_rel"):
            _ = clip.contact_window
        else:
            _ = clip.timestamps_s
    first: tuple[int, ...] = ()
    for frame in range(len(clip)):
        with row.naming("sensor_video", touch, f"frame {frame}: "):
            size = _size_of(clip.encoded(frame), decode=decode)
            first = first or size
            if size != first:
                raise ValueError(f"{_describe(size)}; expected {_describe(first)} as of the first frame")
    return first


def _odd_sizes(
    row: stored_round.StoredRound, sizes: dict[int, tuple[int, ...]], column: str
) -> Iterator[damage.Damage]:
    """List the touches whose pictures differ in size from most of the round; on a tie, from the first."""
    known = {touch: size for touch, size in sizes.items() if size}
    modal = max(known.values(), key=list(known.values()).count, default=())
    for touch, size in known.items():
        if size != modal:
            yield damage.Damage(
                row.path,
                row.number,
                touch,
                column,
                f"{_describe(size)}; expected {_describe(modal)} as of the other touches",
            )


def _describe(size: tuple[int, ...]) -> str:
    return f"{size[1]} x {size[0]} pixels"
