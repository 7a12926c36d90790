"""What a folder holds already of a plan, and whether the plan may go on in it."""

from __future__ import annotations

import json
from collections.abc import Callable, Collection, Mapping
from dataclasses import dataclass, replace
from typing import Any

from tactile_toolkit.errors import InputError, SpecMismatchError
from tactile_toolkit.store.folder import DataFolder
from tactile_toolkit.store.manifest import MANIFEST_FILE, Manifest, part_receipts, read_manifest
from tactile_toolkit.store.plan import BuildPlan, ShardTask
from tactile_toolkit.store.reports import report_rows_per_shard
from tactile_toolkit.store.shards import Receipt, file_sha256, sha256_hex
from tactile_toolkit.versions import toolkit_version

__all__ = ["BuildState", "inspect_folder", "refuse_strangers"]

_LONGEST_SHOWN = 200


@dataclass(frozen=True)
class BuildState:
    """What a folder holds already of a plan.

    Attributes
    ----------
    manifest : Manifest
        Manifest of the folder, or a new one.
    kept : tuple of Receipt
        Finished shards of the plan whose files still match.
    todo : tuple of ShardTask
        Tasks left.
    damaged : tuple of str
        Files that do not match their receipts any more and will be made again.
    """

    manifest: Manifest
    kept: tuple[Receipt, ...]
    todo: tuple[ShardTask, ...]
    damaged: tuple[str, ...]


def inspect_folder(folder: DataFolder, plan: BuildPlan) -> BuildState:
    """Compare a folder with a plan, changing nothing.

    Raises
    ------
    SpecMismatchError
        The folder was made by another specification; the message says what differs.
    InputError
        The folder holds something else.
    """
    manifest = read_manifest(folder)
    if manifest is None:
        refuse_strangers(folder)
        manifest = Manifest(plan.kind, toolkit_version(), plan.spec, plan.split_order)
    _refuse_other_spec(folder, manifest, plan)
    manifest = replace(manifest, trees=plan.trees)
    reported = _report_check(folder, plan)
    known = {receipt.shard: receipt for receipt in (*manifest.receipts, *part_receipts(folder))}
    kept, todo, damaged = [], [], []
    for task in plan.tasks:
        receipt = known.get(task.shard)
        if receipt is not None and _matches(folder, receipt) and reported(receipt) and plan.proves(receipt):
            kept.append(receipt)
            continue
        todo.append(task)
        if receipt is not None:
            damaged.append(task.shard.data_path)
    return BuildState(manifest, tuple(kept), tuple(todo), tuple(damaged))


def _matches(folder: DataFolder, receipt: Receipt) -> bool:
    """Tell whether the file of a shard is there, whole and unchanged."""
    path = receipt.shard.data_path
    if not folder.exists(path) or folder.size_bytes(path) != receipt.bytes:
        return False
    return file_sha256(folder, path) == receipt.sha256


def _report_check(folder: DataFolder, plan: BuildPlan) -> Callable[[Receipt], bool]:
    """Return a test whether the report rows of a shard exist, in its own part or in the merged report."""
    merged = report_rows_per_shard(folder, plan.report_file) if plan.report_file else {}

    def reported(receipt: Receipt) -> bool:
        if receipt.report_sha256 is None:
            return True
        part = receipt.shard.report_path
        if folder.exists(part):
            return file_sha256(folder, part) == receipt.report_sha256
        return receipt.rows == 0 or merged.get(str(receipt.shard)) == receipt.rows

    return reported


def refuse_strangers(folder: DataFolder, ours: Collection[str] = ()) -> None:
    """Refuse a folder that holds somebody's files: a run must never mix with them or delete them.

    Parameters
    ----------
    folder : DataFolder
        Where a run is to write.
    ours : collection of str
        Names that belong to a data set of ours; empty where there is none.

    Raises
    ------
    InputError
        When there is anything else; hidden files do not count.
    """
    strangers = [name for name in folder.names() if not name.startswith(".") and name not in ours]
    if strangers:
        found = f"is not empty and holds no {MANIFEST_FILE}" if not ours else "holds more than a data set"
        message = (
            f"{folder.address()!r} {found} (found {strangers[0]!r}); nothing was changed; next: choose an "
            "empty or new folder (--out or OUT)"
        )
        raise InputError(message)


def _refuse_other_spec(folder: DataFolder, manifest: Manifest, plan: BuildPlan) -> None:
    differences = _differences(
        {"kind": manifest.kind, "toolkit_version": manifest.toolkit_version, **manifest.spec},
        {"kind": plan.kind, "toolkit_version": toolkit_version(), **plan.spec},
    )
    if differences:
        message = (
            f"{folder.address()!r} holds a data set of another specification: {'; '.join(differences)}; "
            "nothing was changed; next: choose another folder (--out or OUT), or start again there with "
            "--overwrite"
        )
        raise SpecMismatchError(message)


def _differences(there: Any, wanted: Any, path: str = "") -> list[str]:
    if isinstance(there, Mapping) and isinstance(wanted, Mapping):
        keys = [*there, *(key for key in wanted if key not in there)]
        return [
            line
            for key in keys
            for line in _differences(there.get(key), wanted.get(key), f"{path}.{key}".lstrip("."))
        ]
    if _like_lists(there, wanted):
        pairs = enumerate(zip(there, wanted, strict=True))
        return [line for place, pair in pairs for line in _differences(*pair, f"{path}[{place}]")]
    if there == wanted:
        return []
    if _are_files(there) or _are_files(wanted):
        return [f"{path} is {_files_text(there)} there, {_files_text(wanted)} asked for"]
    return [f"{path} is {_short(there)} there, {_short(wanted)} was asked for"]


def _are_files(values: Any) -> bool:
    """Tell whether a value is a list of files with their fingerprints, which nobody wants to read."""
    return isinstance(values, list) and all(isinstance(each, Mapping) and "file" in each for each in values)


def _files_text(values: Any) -> str:
    if not _are_files(values):
        return "none" if values is None else _short(values)
    digest = sha256_hex(json.dumps(values, sort_keys=True).encode())[:8]
    return f"{len(values):,} {'file' if len(values) == 1 else 'files'} (fingerprint {digest})"


def _short(value: Any) -> str:
    text = repr(value)
    return text if len(text) <= _LONGEST_SHOWN else f"{text[:_LONGEST_SHOWN]}..."


def _like_lists(there: Any, wanted: Any) -> bool:
    """Tell whether two lists hold the same items, by their names, so that single numbers may differ."""
    if not isinstance(there, list) or not isinstance(wanted, list):
        return False
    if _are_files(there) or _are_files(wanted):
        return False
    names = [[item.get("name") for item in items if isinstance(item, Mapping)] for items in (there, wanted)]
    return names[0] == names[1] and len(names[0]) == len(there) == len(wanted)
