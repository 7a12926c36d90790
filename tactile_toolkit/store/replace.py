"""Starting a folder again without losing what it held, should the new run come to nothing.

The former data set stands aside in a hidden sub-folder until the new run has finished its first shard with
rows in it. A run that fails before puts it back; what a killed one left is put right by the next run.

The manifest tells how far a killed run came: it is moved last when the set goes aside and first when it
comes back. While it stands aside, all else in the folder belongs to the new run; before and after, to the
former set.
"""

from __future__ import annotations

import contextlib
import socket
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from pathlib import Path

from tactile_toolkit.errors import InputError, IntegrityError, StorageError
from tactile_toolkit.store.folder import (
    UNFINISHED,
    DataFolder,
    left_by_the_dead,
    named_failures,
    remove_tree,
    unfinished_name,
)
from tactile_toolkit.store.manifest import MANIFEST_FILE, part_receipts, read_manifest
from tactile_toolkit.store.plan import BuildPlan
from tactile_toolkit.store.resume import BuildState, refuse_strangers
from tactile_toolkit.store.shards import DATA_FOLDER, PARTS_FOLDER, Receipt, ShardName

__all__ = ["Before", "FormerSet", "recover", "require_replaceable"]

_ASIDE = ".replaced"
# Where a set that is given up goes in one step; what a killed run leaves of it there is nobody's any more.
_GONE = ".replaced-gone"
_FOLDERS = (DATA_FOLDER, PARTS_FOLDER, "reports", "previews")
_CARD = "README.md"
# What a data set of ours holds in its folders, by name.
_OWN_NAMES: dict[str, Callable[[str], bool]] = {
    DATA_FOLDER: lambda name: ShardName.parse(name) is not None,
    "reports": lambda name: name.endswith(".parquet"),
    "previews": lambda name: name.endswith(".png"),
}
# Where the former set came from; the new one is no download.
_RECORD = ".download.json"


@dataclass(frozen=True)
class FormerSet:
    """The data set that a run starts to replace.

    Attributes
    ----------
    folder : DataFolder
        Where it was.
    trees : tuple of str
        What it and the new set hold beside rows.
    """

    folder: DataFolder
    trees: tuple[str, ...]

    @classmethod
    def set_aside(cls, folder: DataFolder, trees: tuple[str, ...]) -> FormerSet:
        """Empty a folder for a new run.

        Of remote folders the set is removed at once: moving objects would copy each of them twice.

        Parameters
        ----------
        folder : DataFolder
            Holds a data set of ours, or nothing.
        trees : tuple of str
            What the new set will hold beside rows.

        Raises
        ------
        InputError
            The folder holds something else; nothing was touched.
        StorageError
            Something cannot be moved; what was moved is back.
        """
        there = folder.exists(MANIFEST_FILE)
        former = cls(folder, require_replaceable(folder, trees))
        if there and folder.is_local:
            former._move_away()
        else:
            _remove_all(folder, former.trees)
        return former

    def give_up(self) -> None:
        """Remove the former set: the new one stands on its own."""
        if self.folder.is_local and self.folder.exists(_ASIDE):
            _give_up(self.folder)

    def put_back(self) -> None:
        """Put the former set back, in place of what the new run made; none is no error."""
        if self.folder.is_local and self.folder.exists(_ASIDE):
            _put_back(self.folder, self.trees)

    @property
    def _places(self) -> tuple[str, ...]:
        return (*_FOLDERS, *self.trees, _CARD, _RECORD, MANIFEST_FILE)

    def _move_away(self) -> None:
        held = [name for name in self._places if self.folder.exists(name)]
        with named_failures(self.folder.address()):
            aside = Path(self.folder.address(_ASIDE))
            aside.mkdir()
            (aside / unfinished_name("owner")).touch()
        try:
            _rename(self.folder, ((name, f"{_ASIDE}/{name}") for name in held))
        except BaseException:
            with contextlib.suppress(StorageError):
                _put_back(self.folder, self.trees)
            raise


def require_replaceable(folder: DataFolder, trees: tuple[str, ...]) -> tuple[str, ...]:
    """Refuse a folder that holds more than a data set of ours; nothing is changed.

    Parameters
    ----------
    folder, trees
        As for :meth:`FormerSet.set_aside`.

    Returns
    -------
    tuple of str
        What the set there and the new one hold beside rows.

    Raises
    ------
    InputError
        The folder holds something else.
    """
    both = tuple(dict.fromkeys((*_trees_of(folder), *trees)))
    if not folder.exists(MANIFEST_FILE):
        refuse_strangers(folder)
        return both
    refuse_strangers(folder, _places_of(both))
    _refuse_strangers_inside(folder)
    _require_own_manifest(folder)
    return both


def recover(folder: DataFolder) -> None:
    """Put right what a run that was killed while it replaced a data set left behind.

    Raises
    ------
    InputError
        That run is still at work.
    StorageError
        Something cannot be moved.
    """
    if not folder.is_local:
        return
    if folder.exists(_GONE):
        remove_tree(folder, _GONE)
    if not folder.exists(_ASIDE):
        return
    if any(map(_lives, folder.names(_ASIDE))):
        message = (
            f"another run is replacing the data set in {folder.address()!r} at this moment; nothing was "
            "changed; next: wait until it has ended"
        )
        raise InputError(message)
    # Receipts prove something of the new run only where the former set is away as a whole.
    if folder.exists(f"{_ASIDE}/{MANIFEST_FILE}") and any(part.rows for part in part_receipts(folder)):
        _give_up(folder)
    else:
        _put_back(folder, _trees_of(folder))


def _refuse_strangers_inside(folder: DataFolder) -> None:
    """Refuse files that somebody put among ours; hidden ones do not count."""
    for place, ours in _OWN_NAMES.items():
        for name in folder.names(place):
            if not name.startswith(".") and not ours(name):
                message = (
                    f"{folder.address()!r} holds more than a data set (found '{place}/{name}'); nothing was "
                    "changed; next: move that file away, or choose an empty or new folder (--out or OUT)"
                )
                raise InputError(message)


def _require_own_manifest(folder: DataFolder) -> None:
    """Refuse a file of that name by somebody else; a damaged one of ours has shards beside it."""
    if folder.names(DATA_FOLDER) or folder.names(PARTS_FOLDER):
        return
    try:
        read_manifest(folder)
    except IntegrityError as error:
        message = (
            f"{folder.address(MANIFEST_FILE)!r} may be anybody's: it is no manifest of this toolkit, and no "
            "data lies beside it; nothing was changed; next: choose an empty or new folder (--out or OUT)"
        )
        raise InputError(message) from error


def _places_of(trees: tuple[str, ...]) -> tuple[str, ...]:
    return (*_FOLDERS, *trees, _CARD, MANIFEST_FILE)


def _put_back(folder: DataFolder, trees: tuple[str, ...]) -> None:
    if folder.exists(f"{_ASIDE}/{MANIFEST_FILE}"):
        _remove_all(folder, trees)
    names = [name for name in folder.names(_ASIDE) if not name.startswith(UNFINISHED)]
    names.sort(key=lambda name: name != MANIFEST_FILE)
    _rename(folder, ((f"{_ASIDE}/{name}", name) for name in names))
    remove_tree(folder, _ASIDE)


def _give_up(folder: DataFolder) -> None:
    if folder.exists(_GONE):
        remove_tree(folder, _GONE)
    _rename(folder, ((_ASIDE, _GONE),))
    remove_tree(folder, _GONE)


def _remove_all(folder: DataFolder, trees: Iterable[str]) -> None:
    for tree in trees:
        remove_tree(folder, tree)
    for place in _FOLDERS:
        for name in folder.names(place):
            folder.remove(f"{place}/{name}")
        folder.remove_empty(place)
    for name in (_CARD, _RECORD, MANIFEST_FILE):
        folder.remove(name)


def _rename(folder: DataFolder, moves: Iterable[tuple[str, str]]) -> None:
    for source, target in moves:
        with named_failures(folder.address(target)):
            Path(folder.address(source)).rename(folder.address(target))


def _trees_of(folder: DataFolder) -> tuple[str, ...]:
    """Return what a folder holds beside rows, as far as its manifest can be read."""
    try:
        manifest = read_manifest(folder)
    except IntegrityError:
        return ()
    trees = () if manifest is None else manifest.trees
    # A manifest may be anybody's, of a data set from the Hub: what it names is removed in the end.
    return tuple(tree for tree in trees if tree not in ("", ".", "..") and not set(tree) & set("/\\\0"))


def _lives(name: str) -> bool:
    """Tell whether a name is that of an unfinished file whose writer, on this machine, is at work."""
    return name.startswith(f"{UNFINISHED}{socket.gethostname()}-") and not left_by_the_dead(name)


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
