"""A job: what is being made in a folder, and which of its shards are there.

The record of a shard is the only state: ``.pending/SHARD.json`` until a run is finished, an entry of the
manifest from then on. A record names the job that it is of, so that leftovers of another never count.
"""

from __future__ import annotations

import contextlib
import json
import socket
from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, NamedTuple

from tactile_toolkit.errors import InputError, IntegrityError, SpecMismatchError
from tactile_toolkit.store.folder import NEXT_FOLDER, PENDING_FOLDER, DataFolder
from tactile_toolkit.store.manifest import MANIFEST_FILE, Manifest, read_manifest, write_manifest
from tactile_toolkit.store.origin import RECORD_FILE
from tactile_toolkit.store.parquet import file_sha256, sha256_hex
from tactile_toolkit.store.plan import BuildPlan, ShardTask
from tactile_toolkit.store.reports import report_shards
from tactile_toolkit.store.shards import DATA_FOLDER, ShardEntry, ShardName, ShardRecord
from tactile_toolkit.store.typed_json import Count, decode

CARDS = ("README.md", "croissant.json")
_FOLDERS = (DATA_FOLDER, PENDING_FOLDER, NEXT_FOLDER, "reports", "previews")
_LONGEST_SHOWN = 200

_seen: dict[Job, tuple[object, dict[ShardName, ShardRecord]]] = {}
"""The manifest that was read last, by its version: shards follow each other quickly."""


@dataclass(frozen=True)
class Job:
    """What is being made in a folder; ``of`` is the identity of its manifest.

    Names of shards are the same in every data set of a kind: a slower run would put its rows among those of a
    run that has replaced its set.
    """

    folder: DataFolder
    of: str

    def require(self) -> dict[ShardName, ShardRecord]:
        """Return what the manifest holds; InputError where it is gone, or that of another job by now."""
        version = self.folder.version(MANIFEST_FILE)
        seen = _seen.get(self)
        if seen is not None and version is not None and seen[0] == version:
            return seen[1]
        manifest = read_manifest(self.folder)
        if manifest is None or manifest.identity != self.of:
            if self.folder.exists():
                self.folder.refresh("")  # a network file system may have shown what was there a while ago
            manifest = read_manifest(self.folder)
        if manifest is None:
            raise InputError(
                f"node {socket.gethostname()} writes to a folder that this machine does not see, or the data "
                f"set was removed or replaced while this run was at work: {self.folder.address()!r} holds no "
                f"{MANIFEST_FILE} there; nothing was written",
                next="give a folder that all nodes share, or "
                "s3://BUCKET/PATH, and run the same command again",
            )
        if manifest.identity != self.of:
            raise InputError(
                f"the data set in {self.folder.address()!r} was replaced while this run was at work; it has "
                "stopped and changed nothing of what is there now",
                next="look there with the command `info`, "
                "then run the same command again, or choose another folder (--out or OUT)",
            )
        _seen.clear()
        _seen[self] = version, {record.shard: record for record in manifest.shards}
        return _seen[self][1]


@dataclass(frozen=True)
class State:
    """What a folder holds of a plan.

    ``kept`` are the records of finished shards that are intact, ``todo`` the tasks left.
    """

    manifest: Manifest
    kept: tuple[ShardRecord, ...]
    todo: tuple[ShardTask, ...]


def begin(
    folder: DataFolder, plan: BuildPlan, tasks: Sequence[ShardTask], *, check: bool
) -> tuple[Job, State]:
    """Look what a folder lacks of some tasks, and name there what it is to become, unless that is done.

    Raises as :func:`look`.
    """
    while True:
        state = look(folder, plan, tasks, check=check)
        there = read_manifest(folder)
        if there is None and state.todo:
            folder.create_bytes(MANIFEST_FILE, state.manifest.to_json().encode())
            continue  # read back: another run may have been faster
        if there is not None and there.identity != state.manifest.identity:
            write_manifest(folder, state.manifest)  # of other versions, and none of its shards is left
        return Job(folder, state.manifest.identity), state


def look(
    folder: DataFolder, plan: BuildPlan, tasks: Sequence[ShardTask] | None = None, *, check: bool = False
) -> State:
    """Compare a folder with a plan, or with some of its tasks, changing nothing.

    Raises SpecMismatchError when the folder is made by another specification, or by libraries that write
    other bytes (the message says what differs), and InputError when it holds something else.
    """
    refuse_links(folder, plan.extra_dirs)
    chosen = plan.tasks if tasks is None else tuple(tasks)
    manifest, new = read_manifest(folder), plan.new_manifest()
    if manifest is None:
        try:
            refuse_unknown_files(folder)
        except InputError:
            if folder.exists(MANIFEST_FILE):  # another run began at this moment
                return look(folder, plan, tasks, check=check)
            raise
        return State(new, (), chosen)
    there, wanted = (
        {"kind": each.kind, "toolkit_version": each.toolkit_version, **each.spec} for each in (manifest, new)
    )
    cure = "choose another folder (--out or OUT)"
    _refuse_difference(folder, "holds a data set of another specification", there, wanted, cure)
    _refuse_strays(folder, plan)
    pending = pending_records(folder, manifest.identity, {task.shard for task in chosen})
    holdings = _Holdings(folder, plan, manifest, check)
    listed = {record.shard: record for record in manifest.shards}
    kept, todo = [], []
    for task in chosen:
        known = [each for each in (pending.get(task.shard), listed.get(task.shard)) if each is not None]
        intact = next(filter(holdings.is_intact, known), None)
        if intact is None:
            todo.append(task)
        else:
            kept.append(intact.record if isinstance(intact, Pending) else intact)
    if todo and manifest.libraries and manifest.libraries != new.libraries:
        if {*listed, *_pending_shards(folder)} - {task.shard for task in todo}:
            there, wanted = {"libraries": manifest.libraries}, {"libraries": new.libraries}
            cure = "install those versions, or choose another folder"
            what = "was begun with other versions of libraries, which write other bytes"
            _refuse_difference(folder, what, there, wanted, cure)
        manifest = new
    manifest = replace(manifest, extra_dirs=plan.extra_dirs)
    return State(manifest, tuple(kept), tuple(todo))


class Pending(NamedTuple):
    """The record of a finished shard that no manifest holds yet, with the size of its report rows."""

    record: ShardRecord
    report_bytes: int | None


class _Entry(ShardEntry, frozen=True, kw_only=True):
    of: str
    report_bytes: Count | None = None


def write_record(folder: DataFolder, record: ShardRecord, of: str, report_bytes: int | None = None) -> None:
    """Write the record of a finished shard."""
    values = {**record.to_dict(), "of": of, "report_bytes": report_bytes}
    folder.write_bytes(record.shard.record_path, json.dumps(values, indent=1).encode())


def _pending_shards(folder: DataFolder) -> list[ShardName]:
    """Return the shards of which there are records that no manifest need hold."""
    names = (name.removesuffix(".json") for name in folder.names(PENDING_FOLDER) if name.endswith(".json"))
    return [shard for shard in (ShardName.parse(f"{name}.parquet") for name in names) if shard is not None]


def pending_records(
    folder: DataFolder, of: str, shards: Collection[ShardName] | None = None
) -> dict[ShardName, Pending]:
    """Read the records of a job that no manifest holds yet: of all shards, or of these."""
    chosen = [shard for shard in _pending_shards(folder) if shards is None or shard in shards]
    contents = folder.read_many([shard.record_path for shard in chosen])
    found = {}
    for shard, content in zip(chosen, contents, strict=True):
        # One that cannot be read proves nothing: its shard is made again. It may also have gone since it was
        # listed, because the run has just ended.
        with contextlib.suppress(IntegrityError, ValueError):
            entry = decode(content or b"", _Entry, shard.record_path)
            if entry.of == of:
                found[shard] = Pending(entry.record(), entry.report_bytes)
    return found


@dataclass(frozen=True)
class _Holdings:
    """What lies in a folder, listed once: all that says whether a record is true."""

    folder: DataFolder
    plan: BuildPlan
    manifest: Manifest
    check: bool

    @cached_property
    def _data(self) -> dict[str, int]:
        return self.folder.sizes(DATA_FOLDER)

    @cached_property
    def _pending(self) -> dict[str, int]:
        return self.folder.sizes(PENDING_FOLDER)

    def is_intact(self, known: ShardRecord | Pending) -> bool:
        """Return whether all that a record states is there: by size or, with ``check``, by content."""
        record = known if isinstance(known, ShardRecord) else known.record
        # Sizes first: most damage shows there, and costs no reading.
        if not record.is_size_of(self._data) or not self._has_report(record, known):
            return False
        try:
            if self.check and file_sha256(self.folder, record.shard.data_path) != record.sha256:
                return False
            return self.plan.is_current is None or self.plan.is_current(self.folder, record, self.check)
        except (IntegrityError, FileNotFoundError):  # damaged in the same size, or gone at this moment
            return False

    def _has_report(self, record: ShardRecord, known: ShardRecord | Pending) -> bool:
        if record.report_sha256 is None:
            return True
        if isinstance(known, ShardRecord):
            return record.rows == 0 or self._merged.get(str(record.shard)) == record.rows
        path = record.shard.report_path
        if self._pending.get(path.rpartition("/")[2]) != known.report_bytes:
            return False
        return not self.check or file_sha256(self.folder, path) == record.report_sha256

    @cached_property
    def _merged(self) -> dict[str, int]:
        """How many rows of each shard the merged report has."""
        path = self.plan.report_file
        if path is None or not self.folder.exists(path):
            return {}
        if not self.folder.is_local and not self.check and self.manifest.complete:  # objects appear whole
            return {str(record.shard): record.rows for record in self.manifest.shards}
        try:
            return report_shards(self.folder, path, reads_all=self.check)
        except IntegrityError:
            return {}


def manifest_so_far(folder: DataFolder) -> Manifest | None:
    """Read the manifest of a folder together with what an unfinished run has finished; None without manifest.

    Sizes are compared, no content. Raises IntegrityError when the manifest is damaged.
    """
    manifest = read_manifest(folder)
    if manifest is None:
        return None
    begun = _begun_beside(folder, manifest)
    return replace(manifest.with_shards(begun), complete=False) if begun else manifest


def _begun_beside(folder: DataFolder, manifest: Manifest) -> list[ShardRecord]:
    """Return the pending records that a manifest does not hold and whose files are there."""
    listed, sizes = {record.shard for record in manifest.shards}, folder.sizes(DATA_FOLDER)
    return [
        record
        for shard, (record, _) in pending_records(folder, manifest.identity).items()
        if shard not in listed and shard.split in manifest.split_order and record.is_size_of(sizes)
    ]


def tidy(folder: DataFolder, manifest: Manifest) -> None:
    """Remove what a finished set does not need: records that it holds, temporary files, a set begun inside.

    What another split has begun stays its own until that is finished.
    """
    shards = [record.shard for record in _begun_beside(folder, manifest)]
    kept = {path for shard in shards for path in (shard.record_path, shard.report_path)}
    for path in (f"{PENDING_FOLDER}/{name}" for name in folder.names(PENDING_FOLDER)):
        if path not in kept:
            folder.remove(path)
    folder.remove_empty(PENDING_FOLDER)
    if folder.exists(NEXT_FOLDER):
        folder.remove_tree(NEXT_FOLDER)


def refuse_links(folder: DataFolder, extra_dirs: Iterable[str] = ()) -> None:
    """Refuse a folder in which what a run writes, moves or removes is a symbolic link (InputError)."""
    if folder.is_local:
        for path in (*_FOLDERS, *extra_dirs, *CARDS, RECORD_FILE, MANIFEST_FILE):
            folder.place(path)


def refuse_unknown_files(folder: DataFolder) -> None:
    """Refuse a folder without a data set that holds a user's files: a run must never mix with them."""
    unknown = [name for name in folder.names() if not name.startswith(".")]
    if unknown:
        raise InputError(
            f"{folder.address()!r} is not empty and holds no {MANIFEST_FILE} (found {unknown[0]!r}); nothing "
            "was changed",
            next="choose an empty or new folder (--out or OUT)",
        )


def _refuse_difference(folder: DataFolder, what: str, there: object, wanted: object, cure: str) -> None:
    differing = "; ".join(differences(there, wanted))
    if differing:
        raise SpecMismatchError(
            f"{folder.address()!r} {what}: {differing}; nothing was changed",
            next=f"{cure}, or start again "
            "there with --overwrite (without --part and in no object store; there, remove it first)",
        )


def differences(there: Any, wanted: Any, path: str = "") -> list[str]:
    """State how two JSON values differ, one line for each difference."""
    pairs: Iterable[tuple[str, Any, Any]]
    if isinstance(there, Mapping) and isinstance(wanted, Mapping):
        keys = [*there, *(key for key in wanted if key not in there)]
        pairs = [(f"{path}.{key}".lstrip("."), there.get(key), wanted.get(key)) for key in keys]
    elif (names := _names(there)) and names == _names(wanted):  # so that single numbers may differ
        pairs = [(f"{path}[{index}]", there[index], wanted[index]) for index in range(len(names))]
    elif there == wanted:
        return []
    else:
        return [f"{path} is {_short(there)} there, {_short(wanted)} was asked for"]
    return [line for place, one, other in pairs for line in differences(one, other, place)]


def _names(values: Any) -> list[Any]:
    """Return the names of the items of a list; empty where one has none."""
    if isinstance(values, list) and all(isinstance(each, Mapping) and "name" in each for each in values):
        return [each["name"] for each in values]
    return []


def _short(value: Any) -> str:
    text = repr(value)
    if len(text) <= _LONGEST_SHOWN:
        return text
    if isinstance(value, list):  # such as the files of a source
        digest = sha256_hex(json.dumps(value, sort_keys=True).encode())
        return f"{len(value):,} entries (fingerprint {digest[:8]})"
    return f"{text[:_LONGEST_SHOWN]}..."


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
