"""What a folder holds already of a plan, and whether the plan may go on in it."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

from dataset_store.errors import InputError, SpecMismatchError
from dataset_store.manifest import MANIFEST_FILE, Manifest, read_manifest
from dataset_store.parts import part_receipts
from dataset_store.plan import BuildPlan, ShardTask
from dataset_store.reports import report_rows_per_shard
from dataset_store.shards import Receipt, file_sha256
from dataset_store.storage import DataFolder
from dataset_store.versions import toolkit_version

__all__ = ["BuildState", "inspect_folder", "refuse_strangers"]


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
    reported = _report_check(folder, plan)
    known = {receipt.shard: receipt for receipt in (*manifest.receipts, *part_receipts(folder))}
    kept, todo, damaged = [], [], []
    for task in plan.tasks:
        receipt = known.get(task.shard)
        if receipt is not None and _matches(folder, receipt) and reported(receipt):
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


def refuse_strangers(folder: DataFolder) -> None:
    """Refuse a folder that holds somebody's files: a run must never mix with them or delete them.

    Raises
    ------
    InputError
        When there is a file without a manifest; hidden files do not count.
    """
    strangers = [name for name in folder.names() if not name.startswith(".")]
    if strangers:
        message = (
            f"{folder.address()!r} is not empty and holds no {MANIFEST_FILE} (found {strangers[0]!r}); "
            "nothing was changed; next: choose an empty or new folder with --out"
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
            "nothing was changed; next: choose another --out, or start again there with --overwrite"
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
    return [] if there == wanted else [f"{path} is {there!r} there, {wanted!r} was asked for"]


def _like_lists(there: Any, wanted: Any) -> bool:
    """Tell whether two lists hold the same items, by their names, so that single numbers may differ."""
    if not isinstance(there, list) or not isinstance(wanted, list):
        return False
    names = [[item.get("name") for item in items if isinstance(item, Mapping)] for items in (there, wanted)]
    return names[0] == names[1] and len(names[0]) == len(there) == len(wanted)
