"""Putting a folder back as it was before a run that finished nothing."""

from __future__ import annotations

import contextlib
from dataclasses import dataclass

from dataset_store.errors import StorageError
from dataset_store.manifest import MANIFEST_FILE
from dataset_store.parts import part_receipts
from dataset_store.plan import BuildPlan
from dataset_store.replacing import FormerSet
from dataset_store.resume import BuildState
from dataset_store.shards import DATA_FOLDER, PARTS_FOLDER, Receipt
from dataset_store.storage import DataFolder
from dataset_store.trees import remove_tree

__all__ = ["Before"]


@dataclass(frozen=True)
class Before:
    """What a run found.

    Attributes
    ----------
    there : bool
        Whether the folder existed.
    manifest : bytes or None
        Text of its manifest, where it had one.
    former : FormerSet or None
        The data set that the run replaces.
    """

    there: bool
    manifest: bytes | None
    former: FormerSet | None = None

    @classmethod
    def of(cls, folder: DataFolder, there: bool, former: FormerSet | None = None) -> Before:
        """Remember a folder."""
        manifest = folder.read_bytes(MANIFEST_FILE) if folder.exists(MANIFEST_FILE) else None
        return cls(there, manifest, former)

    def restore_unless_finished(self, folder: DataFolder, plan: BuildPlan, state: BuildState) -> None:
        """Undo a run that failed, unless it finished a shard: then the folder keeps it for the next run.

        A run that cannot be finished (scenes that do not fit, an unreadable source) would otherwise leave a
        folder that holds nothing and refuses every other specification.
        """
        # The failure that ended the run is the one to be told, even where the disk does not let us tidy up.
        with contextlib.suppress(StorageError):
            if not self._finished_any(folder, state):
                self._restore(folder, plan, state)
                if self.former is not None:
                    self.former.put_back()
            elif self.former is not None:
                self.former.give_up()

    def _finished_any(self, folder: DataFolder, state: BuildState) -> bool:
        wanted = {task.shard for task in state.todo}
        return any(receipt.shard in wanted for receipt in _with_rows(folder))

    def _restore(self, folder: DataFolder, plan: BuildPlan, state: BuildState) -> None:
        vouched = {receipt.shard for receipt in (*state.manifest.receipts, *_with_rows(folder))}
        for shard in (task.shard for task in state.todo):
            if shard not in vouched:
                folder.remove(shard.data_path)
                folder.remove(shard.report_path)
                folder.remove(shard.receipt_path)
        if self.manifest is None:
            for tree in plan.trees:
                remove_tree(folder, tree)
            folder.remove(MANIFEST_FILE)
        else:
            folder.write_bytes(MANIFEST_FILE, self.manifest)
        for place in (DATA_FOLDER, PARTS_FOLDER):
            folder.remove_empty(place)
        if not self.there:
            folder.remove_empty("")


def _with_rows(folder: DataFolder) -> list[Receipt]:
    """Return the receipts worth keeping: a shard from which all was left out is made again in no time."""
    return [receipt for receipt in part_receipts(folder) if receipt.rows]
