"""A job: what is to be made in a folder, and which of its shards are there.

The kinds of data bring a :class:`BuildPlan`: one task for each shard, and the specification that they follow
from. The record of a shard is the only state: ``.pending/SHARD.json`` until a run is finished, an entry of
the manifest from then on. A record names the job that it is of, so that leftovers of another never count.
"""

from __future__ import annotations

import contextlib
import json
import socket
from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import lru_cache
from itertools import groupby
from typing import Any, Protocol

import msgspec

from tactile_toolkit import library_versions, toolkit_version
from tactile_toolkit.errors import InputError, IntegrityError, SpecMismatchError
from tactile_toolkit.run.processes import Check, Finish, Part, Runner
from tactile_toolkit.store.folder import NEXT_FOLDER, PENDING_FOLDER, DataFolder
from tactile_toolkit.store.manifest import MANIFEST_FILE, Manifest, read_manifest, write_manifest
from tactile_toolkit.store.names import Count, decode
from tactile_toolkit.store.parquet import ParquetStyle, file_sha256, sha256_hex
from tactile_toolkit.store.shards import DATA_FOLDER, ShardName, ShardRecord, Skipped

_LONGEST_SHOWN = 200


@dataclass(frozen=True)
class ShardContent:
    """The rows of one shard, an Arrow table.

    ``skipped`` are items that gave no row; ``report`` rows are merged over all shards into the plan's
    ``report_file``; ``statistics`` are JSON values that add up over shards, for the manifest. ``files`` lie
    next to the rows, by path. ``encoded`` are the bytes of a shard that is copied as it is.
    """

    table: Any
    skipped: tuple[Skipped, ...] = ()
    report: Any = None
    statistics: Mapping[str, Any] | None = None
    files: Mapping[str, bytes] = field(default_factory=dict)
    encoded: bytes | None = None


class ShardTask(Protocol):
    """The unit of work: a small picklable value from which any process makes the same rows."""

    @property
    def shard(self) -> ShardName:
        """Which shard it makes."""
        ...

    @property
    def size(self) -> int:
        """How many items it works on, for the progress bar."""
        ...

    def make(self) -> ShardContent:
        """Make the rows. Touches no file of the data set folder."""
        ...


@dataclass(frozen=True)
class BuildPlan:
    """What a folder is to hold: one task for each shard, and the specification that they follow from.

    Parameters
    ----------
    kind : str
        Kind of data set, such as ``"mnist3d"``.
    spec : mapping
        Full specification as JSON values. Two plans with equal ``spec`` agree on every row.
    split_order : tuple of str
        Canonical order of the splits of this kind.
    tasks : tuple of ShardTask
        One per shard of the splits asked for.
    style : ParquetStyle
        Layout of the shards.
    report_file : str or None
        Path of the merged report, where shards have one.
    extra_dirs : tuple of str
        Sub-folders (or files) next to the rows that belong to the data set: what tasks give as ``files`` lies
        there.
    is_current : callable, optional
        Takes the folder, the record of a finished shard and whether to read all; returns whether what goes
        with its rows, such as ``files``, is there and unchanged.
    libraries : tuple of str
        Distributions whose versions decide bytes.
    write_files : callable
        Writes files that follow from all rows, such as an index, once those are there; takes the folder and
        the manifest, returns the checksum of each by path.
    """

    kind: str
    spec: Mapping[str, Any]
    split_order: tuple[str, ...]
    tasks: tuple[ShardTask, ...]
    style: ParquetStyle
    report_file: str | None = None
    extra_dirs: tuple[str, ...] = ()
    is_current: Callable[[DataFolder, ShardRecord, bool], bool] | None = field(default=None, repr=False)
    libraries: tuple[str, ...] = ()
    write_files: Callable[[DataFolder, Manifest], Mapping[str, str]] = field(
        default=lambda _folder, _manifest: {}, repr=False
    )

    def __post_init__(self) -> None:
        # What is compared with a manifest has gone through JSON there: tuples became lists.
        text = json.dumps(self.spec, ensure_ascii=False)
        object.__setattr__(self, "spec", json.loads(text))
        try:
            text.encode()
        except UnicodeEncodeError as error:
            found = text[max(0, error.start - 20) : error.end + 20]
            raise InputError(
                f"the specification holds {found!r}, which is not Unicode text", next="give another name"
            ) from error
        splits: dict[str, str] = {}
        for shard in (task.shard for task in self.tasks):
            first = splits.setdefault(shard.split.casefold(), shard.split)
            if first != shard.split or not shard.can_be_read_back:
                raise InputError(
                    f"shard {shard} cannot be named so that it is found again; expected a split of letters, "
                    "digits and underscores that differs from others not in case alone, and an index below "
                    "the count; nothing was changed",
                    next="rename it",
                )

    def new_manifest(self) -> Manifest:
        """Return the manifest of a folder in which nothing is finished."""
        return Manifest(
            self.kind,
            toolkit_version(),
            self.spec,
            self.split_order,
            trees=self.extra_dirs,
            libraries=library_versions(*self.libraries),
        )


def require_known_splits(splits: Sequence[str], known: Sequence[str]) -> None:
    """Raise InputError where a split is asked for that this kind of data set does not have."""
    for split in splits:
        if split not in known:
            raise InputError(f"unknown split {split!r}; expected one of {', '.join(known)}, or all")


class MissingPartsError(IntegrityError):
    """Parts of a data set that cannot be finished yet.

    ``shards`` is how many are missing of ``parts`` in all; ``array`` are the parts that make them, one a
    shard, as Slurm writes numbers of an array.
    """

    def __init__(self, where: str, shards: int, parts: int, array: str) -> None:
        which = "part" if array.isdigit() else "parts"
        super().__init__(
            f"{shards:,} of {parts:,} shards of {where!r} are not finished, or a node writes to a folder "
            f"that this machine does not see; they are those of {which} {array} of {parts:,}",
            next=f"give these (--part auto/{parts}; Slurm: --array={array}), then --finish, or run the same "
            "command without --finish, on a folder that all nodes share, or s3://BUCKET/PATH",
        )
        self.shards, self.parts, self.array = shards, parts, array
        self.args = (where, shards, parts, array)  # by which it crosses process borders


def require_parts(folder: DataFolder, plan: BuildPlan, missing: Collection[ShardName]) -> None:
    """Raise MissingPartsError where any shard of a plan is missing."""
    numbers = [index for index, task in enumerate(plan.tasks) if task.shard in missing]
    if numbers:
        raise MissingPartsError(folder.address(), len(numbers), len(plan.tasks), array_text(numbers))


def array_text(numbers: Sequence[int]) -> str:
    """Write numbers as Slurm takes them for ``--array``: ``3,17,40-44``."""
    runs = [
        [number for _, number in run]
        for _, run in groupby(enumerate(sorted(set(numbers))), lambda pair: pair[1] - pair[0])
    ]
    return ",".join(str(run[0]) if len(run) == 1 else f"{run[0]}-{run[-1]}" for run in runs)


@dataclass(frozen=True)
class Job:
    """What is being made in a folder; ``of`` is the identity of its manifest.

    Names of shards are the same in every data set of a kind: a slower run would put its rows among those of a
    run that has replaced its set.
    """

    folder: DataFolder
    of: str

    def require(self) -> Manifest:
        """Return the manifest; InputError where it is gone, or that of another job by now."""
        folder = self.folder
        version = folder.version(MANIFEST_FILE)
        manifest = None if version is None else _manifest_of_version(folder, version)
        if (manifest is None or manifest.identity != self.of) and folder.exists():
            folder.refresh("")  # a network file system may have shown what was there a while ago
            manifest = read_manifest(folder)
        if manifest is None or manifest.identity != self.of:
            raise InputError(
                f"the data set in {folder.address()!r} was removed or replaced while this run was at work, "
                f"or node {socket.gethostname()} writes to a folder that this machine does not see; it has "
                "stopped and changed nothing of what is there now",
                next="look there with the command `info`, then run the same command again, in a folder that "
                "all nodes share, or choose another one (--out or OUT)",
            )
        return manifest


@lru_cache(maxsize=1)
def _manifest_of_version(folder: DataFolder, version: object) -> Manifest | None:
    """Read a manifest again only where it has changed: shards follow each other quickly."""
    return read_manifest(folder)


@dataclass(frozen=True)
class State:
    """What a folder holds of some tasks of a plan.

    ``kept`` are the records of finished shards that are intact, ``todo`` the tasks left.
    """

    manifest: Manifest
    tasks: tuple[ShardTask, ...]
    kept: tuple[ShardRecord, ...]
    todo: tuple[ShardTask, ...]


def begin(folder: DataFolder, plan: BuildPlan, runner: Runner | int) -> tuple[Job, State]:
    """Find what is missing in a folder for a run, and name there what it is to become, unless that is done.

    Raises as :func:`look`.
    """
    while True:
        state = look(folder, plan, runner)
        there = read_manifest(folder)
        if there is None and state.todo:
            folder.create_bytes(MANIFEST_FILE, state.manifest.to_json().encode())
            continue  # read back: another run may have been faster
        if there is not None and there.identity != state.manifest.identity:
            write_manifest(folder, state.manifest)  # of other versions, and none of its shards is left
        return Job(folder, state.manifest.identity), state


def look(folder: DataFolder, plan: BuildPlan, runner: Runner | int = 1) -> State:
    """Compare a folder with a plan, or with the tasks of a Part, changing nothing; with Check, read it all.

    Raises SpecMismatchError when the folder is made by another specification, or by libraries that write
    other bytes (the message says what differs), InputError when it holds something else, and
    MissingPartsError where shards are missing for a Finish.
    """
    check, runner = (True, runner.workers) if isinstance(runner, Check) else (False, runner)
    tasks = tuple(runner.of(plan.tasks)) if isinstance(runner, Part) else plan.tasks
    manifest, new = read_manifest(folder), plan.new_manifest()
    if manifest is None:
        refuse_unknown_files(folder)
        state = State(new, tasks, (), tasks)
    else:
        there, wanted = (
            {"kind": each.kind, "toolkit_version": each.toolkit_version, **each.spec}
            for each in (manifest, new)
        )
        cure = "choose another folder (--out or OUT)"
        _refuse_difference(folder, "holds a data set of another specification", there, wanted, cure)
        _refuse_strays(folder, plan)
        intact = _intact_records(folder, plan, manifest, {task.shard for task in tasks}, check)
        todo = tuple(task for task in tasks if task.shard not in intact)
        if todo and manifest.libraries and manifest.libraries != new.libraries:
            listed = {record.shard for record in manifest.shards}
            if {*listed, *_pending_shards(folder.names(PENDING_FOLDER))} - {task.shard for task in todo}:
                there, wanted = {"libraries": manifest.libraries}, {"libraries": new.libraries}
                cure = "install those versions, or choose another folder"
                what = "was begun with other versions of libraries, which write other bytes"
                _refuse_difference(folder, what, there, wanted, cure)
            manifest = new
        state = State(replace(manifest, trees=plan.extra_dirs), tasks, tuple(intact.values()), todo)
    if isinstance(runner, Finish):
        require_parts(folder, plan, {task.shard for task in state.todo})
    return state


def _intact_records(
    folder: DataFolder, plan: BuildPlan, manifest: Manifest, shards: Collection[ShardName], check: bool
) -> dict[ShardName, ShardRecord]:
    """Return the record of each shard of which all that it states is there: by size or, to check, by content.

    A pending record counts before that of the manifest.
    """
    sizes = folder.sizes(DATA_FOLDER)
    pending = pending_records(folder, manifest.identity, shards)
    has_report = _is_report_intact(folder, plan, manifest, check)

    def is_intact(record: ShardRecord) -> bool:
        is_pending = pending.get(record.shard) is record
        # Sizes first: most damage shows there, and costs no reading.
        if not record.is_size_of(sizes):
            return False
        if record.report_sha256 and record.rows and not (is_pending or has_report):
            return False
        try:
            if check and file_sha256(folder, record.file) != record.sha256:
                return False
            has_pending_report = is_pending and record.report_sha256 is not None
            report = record.shard.report_path
            if check and has_pending_report and file_sha256(folder, report) != record.report_sha256:
                return False
            return plan.is_current is None or plan.is_current(folder, record, check)
        except (IntegrityError, FileNotFoundError):  # damaged in the same size, or gone at this moment
            return False

    listed = {record.shard: record for record in manifest.shards if record.shard in shards}
    intact = {}
    for known in (listed, pending):
        intact.update({shard: record for shard, record in known.items() if is_intact(record)})
    return intact


def _is_report_intact(folder: DataFolder, plan: BuildPlan, manifest: Manifest, check: bool) -> bool:
    """Return whether the merged report has the rows of all shards of the manifest."""
    path = plan.report_file
    if path is None or not manifest.shards or not folder.exists(path):
        return False
    known = manifest.files.get(path)
    if known is None or not (folder.is_local or check):  # it was being written again, or objects appear whole
        return not check
    return file_sha256(folder, path) == known


class _Pending(msgspec.Struct):
    """What the record of a pending shard states besides: its job, and the size of its report rows."""

    of: str
    report_bytes: Count | None = None


def write_record(folder: DataFolder, record: ShardRecord, of: str, report_bytes: int | None = None) -> None:
    """Write the record of a finished shard."""
    values = {**record.to_dict(), "of": of, "report_bytes": report_bytes}
    folder.write_bytes(record.shard.record_path, json.dumps(values, indent=1).encode())


def _pending_shards(waiting: Iterable[str]) -> list[ShardName]:
    """Return the shards of which there are records, by names of files, that no manifest need hold."""
    names = (name.removesuffix(".json") for name in waiting if name.endswith(".json"))
    return [shard for shard in (ShardName.parse(f"{name}.parquet") for name in names) if shard is not None]


def pending_records(
    folder: DataFolder, of: str, shards: Collection[ShardName] | None = None
) -> dict[ShardName, ShardRecord]:
    """Read the records of a job that no manifest holds yet: of all shards, or of these.

    One whose report rows are not there, or of another size, does not count.
    """
    waiting = folder.sizes(PENDING_FOLDER)
    chosen = [shard for shard in _pending_shards(waiting) if shards is None or shard in shards]
    contents = folder.read_many([shard.record_path for shard in chosen])
    found = {}
    for shard, content in zip(chosen, contents, strict=True):
        # One that cannot be read proves nothing: its shard is made again. It may also have gone since it was
        # listed, because the run has just ended.
        with contextlib.suppress(IntegrityError, ValueError):
            pending = decode(content or b"", _Pending, shard.record_path)
            if (pending.of, pending.report_bytes) == (of, waiting.get(shard.report_path.rpartition("/")[2])):
                record = decode(content or b"", ShardRecord, shard.record_path)
                found[record.shard] = record
    return found


def manifest_so_far(folder: DataFolder) -> Manifest | None:
    """Read the manifest of a folder together with what an unfinished run has finished; None without manifest.

    Sizes are compared, no content. Raises IntegrityError when the manifest is damaged.
    """
    manifest = read_manifest(folder)
    if manifest is None:
        return None
    begun = _begun_records(folder, manifest)
    return replace(manifest.with_shards(begun), complete=False) if begun else manifest


def _begun_records(folder: DataFolder, manifest: Manifest) -> list[ShardRecord]:
    """Return the pending records that a manifest does not hold and whose files are there."""
    listed, sizes = {record.shard for record in manifest.shards}, folder.sizes(DATA_FOLDER)
    return [
        record
        for shard, record in pending_records(folder, manifest.identity).items()
        if shard not in listed and shard.split in manifest.split_order and record.is_size_of(sizes)
    ]


def tidy(folder: DataFolder, manifest: Manifest) -> None:
    """Remove what a finished set does not need: records that it holds, temporary files, a set begun inside.

    What another split has begun stays its own until that is finished.
    """
    shards = [record.shard for record in _begun_records(folder, manifest)]
    kept = {path for shard in shards for path in (shard.record_path, shard.report_path)}
    for path in (f"{PENDING_FOLDER}/{name}" for name in folder.names(PENDING_FOLDER)):
        if path not in kept:
            folder.remove(path)
    folder.remove_empty(PENDING_FOLDER)
    if folder.exists(NEXT_FOLDER):
        folder.remove_tree(NEXT_FOLDER)


def refuse_unknown_files(folder: DataFolder) -> None:
    """Refuse a folder without a data set that holds a user's files: a run must never mix with them."""
    unknown = [name for name in folder.names() if not name.startswith(".")]
    if unknown and MANIFEST_FILE not in unknown:  # another run may have begun at this moment
        raise InputError(
            f"{folder.address()!r} is not empty and holds no {MANIFEST_FILE} (found {unknown[0]!r}); nothing "
            "was changed",
            next="choose an empty or new folder (--out or OUT)",
        )


def _refuse_difference(folder: DataFolder, what: str, there: object, wanted: object, cure: str) -> None:
    differing = "; ".join(_differences(there, wanted))
    if differing:
        raise SpecMismatchError(
            f"{folder.address()!r} {what}: {differing}; nothing was changed",
            next=f"{cure}, or start again there with --overwrite (without --part and in no object store; "
            "there, remove it first)",
        )


def _differences(there: Any, wanted: Any, path: str = "") -> list[str]:
    """State how two JSON values differ, one line for each difference."""
    if isinstance(there, Mapping) and isinstance(wanted, Mapping):
        lines = []
        for key in dict.fromkeys((*there, *wanted)):
            lines += _differences(there.get(key), wanted.get(key), f"{path}.{key}".lstrip("."))
        return lines
    if there == wanted:
        return []
    return [f"{path} is {_short(there)} there, {_short(wanted)} was asked for"]


def _short(value: Any) -> str:
    """Return a value as text, with a digest of one that is cut short, such as the files of a source."""
    text = repr(value)
    if len(text) <= _LONGEST_SHOWN:
        return text
    short = f"{len(value):,} entries" if isinstance(value, list) else f"{text[:_LONGEST_SHOWN]}..."
    return f"{short} (fingerprint {sha256_hex(text.encode())[:8]})"


def _refuse_strays(folder: DataFolder, plan: BuildPlan) -> None:
    """Refuse a file among the shards that is none, which would be found to be wrong ever after.

    A shard of a split that is not asked for may be of a run that is at work on it.
    """
    planned = {task.shard for task in plan.tasks}
    others = set(plan.split_order) - {shard.split for shard in planned}
    for name in folder.names(DATA_FOLDER):
        shard = ShardName.parse(name)
        if not name.startswith(".") and shard not in planned and (shard is None or shard.split not in others):
            raise InputError(
                f"{folder.address(f'{DATA_FOLDER}/{name}')!r} is not a file of this data set; nothing was "
                "changed",
                next="remove it, or move it away",
            )
