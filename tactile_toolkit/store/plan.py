"""What is to be built, and what a folder holds of it already."""

from __future__ import annotations

import contextlib
import json
from collections import Counter
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, Protocol

from tactile_toolkit.errors import InputError, IntegrityError, SpecMismatchError
from tactile_toolkit.store.folder import DataFolder
from tactile_toolkit.store.manifest import MANIFEST_FILE, Manifest, pending_records, read_manifest
from tactile_toolkit.store.parquet import ParquetStyle, file_sha256, sha256_hex
from tactile_toolkit.store.parts import PartsPlan, read_parts_plan
from tactile_toolkit.store.reports import report_shards
from tactile_toolkit.store.shards import DATA_FOLDER, PENDING_FOLDER, ShardName, ShardRecord, Skipped
from tactile_toolkit.versions import library_versions, toolkit_version

__all__ = [
    "BuildPlan",
    "BuildState",
    "ShardContent",
    "ShardTask",
    "inspect_folder",
    "refuse_other_division",
    "refuse_other_parts",
    "refuse_unknown_files",
    "require_known_splits",
]

_LONGEST_SHOWN = 200


@dataclass(frozen=True)
class ShardContent:
    """The rows of one shard, an Arrow table.

    ``skipped`` are items that gave no row; ``report`` rows are merged over all shards into the plan's
    ``report_file``; ``statistics`` are JSON values that add up over shards, for the manifest.
    """

    table: Any
    skipped: tuple[Skipped, ...] = ()
    report: Any = None
    statistics: Mapping[str, Any] | None = None


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
        Sub-folders (or files) beside the rows that belong to the data set: tasks fill them with files of
        their own.
    extras_intact : callable
        Tells whether all that a finished shard wrote into ``extra_dirs`` is still whole, by its content or,
        where the second argument is False, by its being there.
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
    extras_intact: Callable[[ShardRecord, bool], bool] = field(default=lambda *_: True, repr=False)
    libraries: tuple[str, ...] = ()
    write_files: Callable[[DataFolder, Manifest], Mapping[str, str]] = field(
        default=lambda _folder, _manifest: {}, repr=False
    )

    def __post_init__(self) -> None:
        # What is compared with a manifest has gone through JSON there: tuples became lists.
        object.__setattr__(self, "spec", json.loads(json.dumps(self.spec)))
        try:
            json.dumps(self.spec, ensure_ascii=False).encode()
        except UnicodeEncodeError as error:
            found = error.object[max(0, error.start - 20) : error.end + 20]
            message = (
                f"the specification holds {found!r}, which is not Unicode text; nothing was changed; next: "
                "give another name"
            )
            raise InputError(message) from error
        splits: dict[str, str] = {}
        for split in dict.fromkeys(task.shard.split for task in self.tasks):
            first = splits.setdefault(split.casefold(), split)
            if first != split:
                message = (
                    f"the splits {first!r} and {split!r} differ in case alone, and their files would be the "
                    "same on many file systems; expected other names; nothing was changed; next: rename one"
                )
                raise InputError(message)
        for shard in (task.shard for task in self.tasks):
            if not shard.can_be_read_back:
                message = (
                    f"shard {shard} cannot be named so that it is found again; expected a split of letters, "
                    "digits and underscores, and an index below the count; nothing was changed; next: call "
                    f"the split {shard.split!r} something else"
                )
                raise InputError(message)

    def for_parts(self, count: int) -> PartsPlan:
        """Return what so many parts that make this have to agree on."""
        return PartsPlan(
            count,
            dict(Counter(task.shard.split for task in self.tasks)),
            self.kind,
            toolkit_version(),
            library_versions(*self.libraries),
            self.spec,
        )

    def new_manifest(self) -> Manifest:
        """Return the manifest of a folder in which nothing is finished."""
        return Manifest(
            self.kind,
            toolkit_version(),
            self.spec,
            self.split_order,
            extra_dirs=self.extra_dirs,
            libraries=library_versions(*self.libraries),
        )


def require_known_splits(splits: Sequence[str], known: Sequence[str]) -> None:
    """Raise InputError where a split is asked for that this kind of data set does not have."""
    for split in splits:
        if split not in known:
            message = f"unknown split {split!r}; expected one of {', '.join(known)}, or all"
            raise InputError(message)


@dataclass(frozen=True)
class BuildState:
    """What a folder holds already of a plan.

    ``kept`` are finished shards whose files still match, ``todo`` the tasks left. ``damaged`` are paths that
    do not match their records any more and will be made again. ``agreed`` is what parts that are at work in
    the folder agreed on. ``unproven`` are paths of pending files of which nothing says what run they are of.
    """

    manifest: Manifest
    kept: tuple[ShardRecord, ...]
    todo: tuple[ShardTask, ...]
    damaged: tuple[str, ...] = ()
    agreed: PartsPlan | None = None
    unproven: tuple[str, ...] = ()


def inspect_folder(
    folder: DataFolder,
    plan: BuildPlan,
    tasks: Sequence[ShardTask] | None = None,
    *,
    in_parts: bool = False,
    check: bool = False,
) -> BuildState:
    """Compare a folder with a plan, or with some of its tasks, changing nothing.

    A record counts where its file is there in full size; in local folders also its checksum is compared, but
    not ``in_parts``; with ``check`` it always is. Raises SpecMismatchError when the folder was made by
    another specification (the message says what differs), and InputError when it holds something else.
    """
    # Listed before what says whose they are is looked for: it is written before any of them, and goes last.
    pending = folder.names(PENDING_FOLDER)
    manifest, agreed = read_manifest(folder), read_parts_plan(folder)
    if agreed is not None:
        refuse_other_parts(folder, agreed, plan)
    chosen = plan.tasks if tasks is None else tuple(tasks)
    if manifest is None and agreed is None:
        try:
            refuse_unknown_files(folder)
        except InputError:
            if folder.exists(MANIFEST_FILE):  # another run began at this moment
                return inspect_folder(folder, plan, tasks, in_parts=in_parts, check=check)
            raise
        # Pending records that nothing stands beside may be of any specification: they prove nothing.
        unproven = tuple(f"{PENDING_FOLDER}/{name}" for name in pending if not name.startswith("."))
        return BuildState(plan.new_manifest(), (), chosen, unproven=unproven)
    if manifest is None:  # the first part was killed between the two
        manifest = plan.new_manifest()
    differences = _differences(
        {"kind": manifest.kind, "toolkit_version": manifest.toolkit_version, **manifest.spec},
        {"kind": plan.kind, "toolkit_version": toolkit_version(), **plan.spec},
    )
    if differences:
        message = (
            f"{folder.address()!r} holds a data set of another specification: {'; '.join(differences)}; "
            f"nothing was changed; next: choose another folder (--out or OUT){_or_again(folder, in_parts)}"
        )
        raise SpecMismatchError(message)
    _refuse_strays(folder, plan)
    asked_for = None if tasks is None else [task.shard for task in chosen]
    known = {record.shard: record for record in (*manifest.shards, *pending_records(folder, asked_for))}
    recorded = [known[task.shard] for task in chosen if task.shard in known]
    is_finished = _finished_check(folder, plan, manifest, recorded, in_parts=in_parts, check=check)
    kept, todo, damaged = [], [], []
    for task in chosen:
        record = known.get(task.shard)
        if record is not None and is_finished(record):
            kept.append(record)
            continue
        todo.append(task)
        if record is not None:
            damaged.append(task.shard.data_path)
    made_again = {task.shard for task in todo}
    if todo and any(shard not in made_again for shard in known):
        _refuse_other_libraries(folder, manifest, plan, in_parts)
    elif todo:
        manifest = replace(manifest, libraries=plan.new_manifest().libraries)
    manifest = replace(manifest, extra_dirs=plan.extra_dirs)
    return BuildState(manifest, tuple(kept), tuple(todo), tuple(damaged), agreed)


def _finished_check(
    folder: DataFolder,
    plan: BuildPlan,
    manifest: Manifest,
    records: Sequence[ShardRecord],
    *,
    in_parts: bool,
    check: bool,
) -> Callable[[ShardRecord], bool]:
    """Return a test whether all that one of these records vouches for is there; lists the folder once."""
    sizes = folder.sizes(DATA_FOLDER)
    has_report = _report_check(folder, plan, manifest, records, check)
    reads_extras = check or folder.is_local
    reads = reads_extras and (check or not in_parts)

    def is_finished(record: ShardRecord) -> bool:
        # Sizes first: most damage shows there, and costs no reading.
        if not record.is_size_of(sizes) or not has_report(record):
            return False
        try:
            if reads and file_sha256(folder, record.shard.data_path) != record.sha256:
                return False
            return plan.extras_intact(record, reads_extras)
        except (IntegrityError, FileNotFoundError):  # damaged in the same size, or gone at this moment
            return False

    return is_finished


def refuse_other_parts(folder: DataFolder, agreed: PartsPlan, plan: BuildPlan) -> None:
    """Refuse to work beside parts that make something else, or make it with what writes other bytes."""
    differences = _differences(agreed.identity(), plan.for_parts(1).identity())
    if differences:
        message = (
            f"parts are making another data set in {folder.address()!r}: {'; '.join(differences)}; nothing "
            "was changed; next: give the options, and install the versions, that the first part had, or "
            "choose another folder (--out or OUT)"
        )
        raise SpecMismatchError(message)


def refuse_other_division(folder: DataFolder, agreed: PartsPlan, wanted: PartsPlan) -> None:
    """Refuse a part of another number of parts, or of other splits, than those that are at work."""
    differences = _differences(agreed.division(), wanted.division())
    if differences:
        message = (
            f"{folder.address()!r} is being made in other parts: {'; '.join(differences)}; nothing was "
            f"changed; next: give --part K/{agreed.parts} for the same splits, or finish those first "
            "(--finish)"
        )
        raise SpecMismatchError(message)


def _refuse_other_libraries(folder: DataFolder, manifest: Manifest, plan: BuildPlan, in_parts: bool) -> None:
    """Refuse to go on with libraries that write other bytes; a folder that names none was made by 0.1.0."""
    now = plan.new_manifest().libraries
    differences = _differences(manifest.libraries, now, "libraries") if manifest.libraries else []
    if differences:
        message = (
            f"{folder.address()!r} was begun with other versions of libraries, which write other bytes: "
            f"{'; '.join(differences)}; nothing was changed; next: install those versions, or choose another "
            f"folder{_or_again(folder, in_parts)}"
        )
        raise SpecMismatchError(message)


def _or_again(folder: DataFolder, in_parts: bool) -> str:
    """Return the end of a next step: parts replace no set, and nobody one in an object store."""
    if in_parts or not folder.is_local:
        return f", or remove {folder.address()!r} first"
    return ", or start again there with --overwrite"


def _refuse_strays(folder: DataFolder, plan: BuildPlan) -> None:
    """Refuse a file among the shards that is none, which would be found to be wrong ever after.

    A shard of a split that is not asked for may be of a run that is at work on it.
    """
    planned = {task.shard for task in plan.tasks}
    others = set(plan.split_order) - {shard.split for shard in planned}
    for name in folder.names(DATA_FOLDER):
        shard = ShardName.parse(name)
        if not name.startswith(".") and shard not in planned and (shard is None or shard.split not in others):
            message = (
                f"{folder.address(f'{DATA_FOLDER}/{name}')!r} is not a file of this data set; nothing was "
                "changed; next: remove it, or move it away"
            )
            raise InputError(message)


def _report_check(
    folder: DataFolder, plan: BuildPlan, manifest: Manifest, records: Sequence[ShardRecord], check: bool
) -> Callable[[ShardRecord], bool]:
    """Return a test whether the report rows of one of these exist, in a file of their own or merged."""
    merged: dict[str, int] = {}
    if not (folder.is_local or check) and manifest.complete and plan.report_file in (manifest.files or {}):
        is_merged = folder.exists(str(plan.report_file))
        return lambda _: is_merged
    if plan.report_file is not None and folder.exists(plan.report_file):
        with contextlib.suppress(IntegrityError):  # a damaged report holds no rows
            merged = report_shards(folder, plan.report_file)
    there = {f"{PENDING_FOLDER}/{name}" for name in folder.names(PENDING_FOLDER)}
    paths = [record.shard.report_path for record in records if record.shard.report_path in there]
    digests = {
        path: None if content is None else sha256_hex(content)
        for path, content in zip(paths, folder.read_many(paths), strict=True)
    }

    def has_report(record: ShardRecord) -> bool:
        if record.report_sha256 is None:
            return True
        if record.shard.report_path in digests:
            return digests[record.shard.report_path] == record.report_sha256
        return record.rows == 0 or merged.get(str(record.shard)) == record.rows

    return has_report


def refuse_unknown_files(folder: DataFolder, ours: Collection[str] = ()) -> None:
    """Refuse a folder that holds somebody's files: a run must never mix with them or delete them.

    ``ours`` are names that belong to a data set of ours, none where there is none; hidden files do not count.
    """
    unknown = [name for name in folder.names() if not name.startswith(".") and name not in ours]
    if unknown:
        found = "holds more than a data set" if ours else f"is not empty and holds no {MANIFEST_FILE}"
        message = (
            f"{folder.address()!r} {found} (found {unknown[0]!r}); nothing was changed; next: choose an "
            "empty or new folder (--out or OUT)"
        )
        raise InputError(message)


def _differences(there: Any, wanted: Any, path: str = "") -> list[str]:
    """Say how two JSON values differ, one line for each difference."""
    if isinstance(there, Mapping) and isinstance(wanted, Mapping):
        keys = [*there, *(key for key in wanted if key not in there)]
        return [
            line
            for key in keys
            for line in _differences(there.get(key), wanted.get(key), f"{path}.{key}".lstrip("."))
        ]
    if _hold_the_same_names(there, wanted):
        pairs = enumerate(zip(there, wanted, strict=True))
        return [line for index, pair in pairs for line in _differences(*pair, f"{path}[{index}]")]
    if there == wanted:
        return []
    if _are_files(there) or _are_files(wanted):
        return [f"{path} is {_files_text(there)} there, {_files_text(wanted)} asked for"]
    return [f"{path} is {_short(there)} there, {_short(wanted)} was asked for"]


def _hold_the_same_names(there: Any, wanted: Any) -> bool:
    """Tell whether two lists hold the same items, by their names, so that single numbers may differ."""
    if not isinstance(there, list) or not isinstance(wanted, list):
        return False
    if _are_files(there) or _are_files(wanted):
        return False
    names = [[item.get("name") for item in items if isinstance(item, Mapping)] for items in (there, wanted)]
    return names[0] == names[1] and len(names[0]) == len(there) == len(wanted)


def _are_files(values: Any) -> bool:
    """Tell whether a value is a list of files with their fingerprints, which nobody wants to read."""
    return (
        bool(values)
        and isinstance(values, list)
        and all(isinstance(v, Mapping) and "file" in v for v in values)
    )


def _files_text(values: Any) -> str:
    if not _are_files(values):
        return "none" if values is None else _short(values)
    digest = sha256_hex(json.dumps(values, sort_keys=True).encode())[:8]
    return f"{len(values):,} {'file' if len(values) == 1 else 'files'} (fingerprint {digest})"


def _short(value: Any) -> str:
    text = repr(value)
    return text if len(text) <= _LONGEST_SHOWN else f"{text[:_LONGEST_SHOWN]}..."
