"""Starting a folder again without losing what it held, should the new run come to nothing.

The former data set stands aside in a hidden sub-folder until the new run has finished its first shard with
rows in it. A run that fails before puts it back; what a killed one left is put right by the next run.

The manifest tells how far a killed run came: it is moved last when the set goes aside and first when it
comes back. While it stands aside, all else in the folder belongs to the new run; before and after, to the
former set.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass, field
from fnmatch import fnmatch
from pathlib import Path

from tactile_toolkit.errors import InputError, IntegrityError
from tactile_toolkit.kind import kinds
from tactile_toolkit.store.folder import (
    TEMPORARY_PREFIX,
    DataFolder,
    being_written,
    remove_tree,
    temporary_name,
)
from tactile_toolkit.store.manifest import MANIFEST_FILE, pending_records, read_manifest
from tactile_toolkit.store.origin import RECORD_FILE
from tactile_toolkit.store.parts import PARTS_FILE
from tactile_toolkit.store.plan import BuildPlan, BuildState, refuse_unknown_files
from tactile_toolkit.store.shards import DATA_FOLDER, PENDING_FOLDER, ShardName, ShardRecord

__all__ = [
    "FolderBefore",
    "FormerSet",
    "recover",
    "refuse_links",
    "refuse_unrecovered",
    "require_replaceable",
]

_ASIDE = ".replaced"
# Where a set that is given up goes in one step; what a killed run leaves of it there is nobody's any more.
_GONE = ".replaced-gone"
_ended: set[str] = set()
"""Owners of former sets whose runs in this process have ended, whatever they could tidy up."""
_FOLDERS = (DATA_FOLDER, PENDING_FOLDER, "reports", "previews")
_CARDS = ("README.md", "croissant.json")
# What a data set of ours holds in its folders, by name.
_OWN_NAMES: dict[str, Callable[[str], bool]] = {
    DATA_FOLDER: lambda name: ShardName.parse(name) is not None,
    "reports": lambda name: name.endswith(".parquet"),
    "previews": lambda name: name.endswith(".png"),
}


@dataclass
class FormerSet:
    """The data set that a run starts to replace; ``extra_dirs`` are those of it and of the new set."""

    folder: DataFolder
    extra_dirs: tuple[str, ...]
    _owner: str = field(default_factory=lambda: f"{_ASIDE}/{temporary_name('owner')}")

    def set_aside(self) -> None:
        """Empty the folder, which holds a data set of ours or nothing, for a new run.

        Raises InputError when it holds something else, and nothing was touched; StorageError when something
        cannot be moved. After any exception :meth:`put_back` brings back what was moved.
        """
        there = self.folder.exists(MANIFEST_FILE)
        self.extra_dirs = require_replaceable(self.folder, self.extra_dirs)
        if not there:
            _remove_all(self.folder, self.extra_dirs)
            return
        # The record of a download goes too: the new set is not one. The manifest goes last.
        paths = (*_FOLDERS, *self.extra_dirs, *_CARDS, RECORD_FILE, MANIFEST_FILE)
        held = [path for path in paths if self.folder.exists(path)]
        self.folder.write_bytes(self._owner, b"")  # this process is at work, see recover
        for path in held:
            self.folder.rename(path, f"{_ASIDE}/{path}")

    def end(self) -> None:
        """Let any run put right what this one leaves, in this process too."""
        _ended.add(self._owner)

    def give_up(self) -> None:
        """Remove the former set: the new one stands on its own."""
        if self._is_aside():
            _give_up(self.folder)

    def put_back(self) -> None:
        """Put the former set back, in place of what the new run made; none is not an error."""
        if self._is_aside():
            _put_back(self.folder, self.extra_dirs)

    def _is_aside(self) -> bool:
        """Return whether the set that this run has put aside is still there."""
        return self.folder.is_local and self.folder.exists(self._owner)


def refuse_links(folder: DataFolder, extra_dirs: Iterable[str] = ()) -> None:
    """Refuse a folder in which what a run writes, moves or removes is a symbolic link (InputError)."""
    if folder.is_local:
        for path in (*_FOLDERS, _ASIDE, _GONE, *extra_dirs, *_CARDS, RECORD_FILE, MANIFEST_FILE):
            folder.place(path)


def require_replaceable(folder: DataFolder, extra_dirs: tuple[str, ...]) -> tuple[str, ...]:
    """Return the extra folders of the set in a folder and of a new one; nothing is changed.

    Raises InputError when the folder holds more than a data set of ours, and for one in an object store: that
    cannot rename, so that all of a set would be copied twice to set it aside; and both sets have files of the
    same names, so that readers of the former one would be given rows of the new one.
    """
    if not folder.is_local and folder.exists(MANIFEST_FILE):
        message = (
            f"{folder.address()!r} holds a data set, and --overwrite replaces none in an object store, where "
            "it could not be put back if the new run fails; nothing was changed; next: choose another folder "
            "(--out or OUT), or remove that one with the store's own tools"
        )
        raise InputError(message)
    before = _extra_dirs_of(folder)
    both = tuple(dict.fromkeys((*before, *extra_dirs)))
    refuse_links(folder, both)
    if not folder.exists(MANIFEST_FILE):
        refuse_unknown_files(folder)
        return both
    # What only the new set is to have is not of the former one: it is somebody's.
    refuse_unknown_files(folder, (*_FOLDERS, *before, *_CARDS, MANIFEST_FILE))
    found = [
        f"{path}/{name}"
        for path, is_ours in _OWN_NAMES.items()
        for name in _own_files(folder, path)
        if not name.startswith(".") and not is_ours(name)
    ]
    found += [file for path in before for file in _files_below(folder, path) if not _is_extra(file)]
    if found:
        message = (
            f"{folder.address()!r} holds more than a data set (found {found[0]!r}); nothing was changed; "
            "next: move that file away, or choose an empty or new folder (--out or OUT)"
        )
        raise InputError(message)
    # A damaged manifest of ours has shards beside it; other programs have files of that name, too.
    if not folder.names(DATA_FOLDER) and not folder.names(PENDING_FOLDER):
        try:
            read_manifest(folder)
        except IntegrityError as error:
            message = (
                f"{folder.address(MANIFEST_FILE)!r} may be anybody's: it is not a manifest of this toolkit, "
                "and no data lies beside it; nothing was changed; next: choose an empty or new folder (--out "
                "or OUT)"
            )
            raise InputError(message) from error
    return both


def recover(folder: DataFolder) -> None:
    """Put right what a run that was killed while it replaced a data set left behind.

    Raises InputError when that run is still at work.
    """
    if not folder.is_local:
        return
    if folder.exists(_GONE):
        remove_tree(folder, _GONE)
    if not folder.exists(_ASIDE):
        return
    owners = being_written(Path(folder.address(_ASIDE)))
    if any(f"{_ASIDE}/{owner.name}" not in _ended for owner in owners):
        message = (
            f"another run is replacing the data set in {folder.address()!r} at this moment; nothing was "
            f"changed; next: wait until it has ended (where it was killed on another machine, remove "
            f"{str(owners[0])!r})"
        )
        raise InputError(message)
    # Records prove something of the new run only where the former set is away as a whole.
    if folder.exists(f"{_ASIDE}/{MANIFEST_FILE}") and _with_rows(folder):
        _give_up(folder)
    else:
        _put_back(folder, _extra_dirs_of(folder))


def refuse_unrecovered(folder: DataFolder) -> None:
    """Leave to others what :func:`recover` would put right, and say so (InputError)."""
    if folder.is_local and folder.exists(_ASIDE):
        message = (
            f"a run is replacing, or was killed while it replaced, the data set in {folder.address()!r}; "
            "nothing was changed; next: give the command that was at work there once more, without --part "
            "and --finish, or choose another folder (--out or OUT)"
        )
        raise InputError(message)


def _put_back(folder: DataFolder, extra_dirs: tuple[str, ...]) -> None:
    if folder.exists(f"{_ASIDE}/{MANIFEST_FILE}"):
        _remove_all(folder, extra_dirs)
    names = [name for name in folder.names(_ASIDE) if not name.startswith(TEMPORARY_PREFIX)]
    names.sort(key=lambda name: name != MANIFEST_FILE)
    for name in names:
        folder.rename(f"{_ASIDE}/{name}", name)
    remove_tree(folder, _ASIDE)


def _give_up(folder: DataFolder) -> None:
    if folder.exists(_GONE):
        remove_tree(folder, _GONE)
    folder.rename(_ASIDE, _GONE)
    remove_tree(folder, _GONE)


def _remove_all(folder: DataFolder, extra_dirs: Iterable[str]) -> None:
    for path in extra_dirs:
        remove_tree(folder, path)
    for path in _FOLDERS:
        for name in folder.names(path):
            folder.remove(f"{path}/{name}")
        folder.remove_empty(path)
    for name in (*_CARDS, RECORD_FILE, MANIFEST_FILE):
        folder.remove(name)


def _extra_dirs_of(folder: DataFolder) -> tuple[str, ...]:
    """Return the extra folders of a data set, as far as its manifest can be read."""
    try:
        manifest = read_manifest(folder)
    except IntegrityError:
        return ()
    names = () if manifest is None else manifest.extra_dirs
    # A manifest may be anybody's, of a data set from the Hub, and what is returned is removed in the end.
    known = {pattern.partition("/")[0] for pattern in _extra_files()} if names else set()
    return tuple(name for name in names if name in known)


def _extra_files() -> list[str]:
    return [pattern for kind in kinds() for pattern in kind.extra_files]


def _is_extra(path: str) -> bool:
    """Tell whether data sets of some kind have files of such a name, or a run that was killed left one."""
    parts = path.split("/")
    if parts[-1].startswith(TEMPORARY_PREFIX):
        return True
    patterns = (pattern.split("/") for pattern in _extra_files())
    return any(len(each) == len(parts) and all(map(fnmatch, parts, each)) for each in patterns)


def _own_files(folder: DataFolder, path: str) -> list[str]:
    """List the names in a sub-folder; InputError where one is a symbolic link."""
    names = folder.names(path)
    for name in names if folder.is_local else ():
        folder.place(f"{path}/{name}")
    return names


def _files_below(folder: DataFolder, path: str) -> list[str]:
    """List the files in a sub-folder, or the file of that name; InputError where one is a symbolic link."""
    if not folder.exists(path):
        return []
    names = _own_files(folder, path)
    if not names or names == [path.rpartition("/")[2]]:  # object stores list a file as if it held itself
        return [] if folder.is_local and Path(folder.address(path)).is_dir() else [path]
    return [file for name in names for file in _files_below(folder, f"{path}/{name}")]


@dataclass
class FolderBefore:
    """What a run found: whether the folder existed, the set it replaces, its manifest and what it lacked.

    ``mine`` is the version of the manifest that this run, once it had ``begun``, has left there.
    """

    existed: bool
    former: FormerSet | None = None
    manifest: bytes | None = None
    state: BuildState | None = None
    begun: bool = False
    mine: tuple[object, ...] | None = None

    def restore_unless_finished(self, folder: DataFolder, plan: BuildPlan) -> None:
        """Undo a run that failed, unless it finished a shard: then the folder keeps it for the next run.

        A run that cannot be finished (scenes that do not fit, an unreadable source) would otherwise leave a
        folder that holds nothing and refuses every other specification. Where another run has begun there
        since, or parts have, all is theirs and stays.
        """
        if folder.version(MANIFEST_FILE) != self.mine or folder.exists(PARTS_FILE):
            return
        if self.state is not None:
            wanted = {task.shard for task in self.state.todo}
            if any(record.shard in wanted for record in _with_rows(folder)):
                if self.former is not None:
                    self.former.give_up()
                return
            self._restore(folder, plan, self.state)
        if self.former is not None:
            self.former.put_back()
        if not self.existed:
            folder.remove_empty("")

    def _restore(self, folder: DataFolder, plan: BuildPlan, state: BuildState) -> None:
        vouched = {record.shard for record in (*state.manifest.shards, *_with_rows(folder))}
        for shard in (task.shard for task in state.todo):
            if shard not in vouched:
                folder.remove(shard.data_path)
                folder.remove(shard.report_path)
                folder.remove(shard.record_path)
        if self.manifest is None:
            for path in plan.extra_dirs:
                remove_tree(folder, path)
            folder.remove(MANIFEST_FILE)
        else:
            folder.write_bytes(MANIFEST_FILE, self.manifest)
        for path in (DATA_FOLDER, PENDING_FOLDER):
            folder.remove_empty(path)


def _with_rows(folder: DataFolder) -> list[ShardRecord]:
    """Return the records worth keeping: a shard from which all was left out is made again in no time."""
    return [record for record in pending_records(folder) if record.rows]
