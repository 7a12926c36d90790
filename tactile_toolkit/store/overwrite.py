"""Starting a folder again: the new data set is made in ``OUT/.next``, then takes the place of the former one.

Until it is finished nothing of the former set is touched. From the moment that the list of its files is
there, whatever makes or loads the set next carries on with putting it in place.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import PurePosixPath

import msgspec

from tactile_toolkit.errors import InputError, IntegrityError
from tactile_toolkit.kind import kinds
from tactile_toolkit.run.processes import Finish, Part, Runner
from tactile_toolkit.store.files import TEMPORARY_PREFIX
from tactile_toolkit.store.folder import NEXT_FOLDER, PENDING_FOLDER, DataFolder
from tactile_toolkit.store.job import BuildPlan, refuse_unknown_files
from tactile_toolkit.store.manifest import MANIFEST_FILE, Manifest, read_manifest, write_manifest
from tactile_toolkit.store.names import decode
from tactile_toolkit.store.origin import RECORD_FILE
from tactile_toolkit.store.shards import DATA_FOLDER, ShardName

# Lists the files of the former data set that the next one does not have.
_PROMOTION = f"{NEXT_FOLDER}/.promotion.json"
_PATIENCE_S = 60.0
_OURS = ("reports/*.parquet", "previews/*.png", "README.md", "croissant.json", RECORD_FILE, MANIFEST_FILE)


def require_replaceable(folder: DataFolder) -> list[str]:
    """Return the files of the data set that a run may replace, none where there is none; changes nothing.

    All files of a data set are known by their names; other hidden files stay. Raises
    InputError for any other file, a symbolic link above all, and for a set in an object store, which moves
    no file.
    """
    if not folder.exists(MANIFEST_FILE):
        refuse_unknown_files(folder)
        return []
    if not folder.is_local:
        raise InputError(
            f"{folder.address()!r} holds a data set, and --overwrite replaces none in an object store, where "
            "it could not be put back if the new run fails; nothing was changed",
            next="choose another folder (--out or OUT), or remove that one with the store's own tools",
        )
    manifest = _manifest(folder)
    # A manifest may be any user's, of a data set from the Hub: what it names counts where kinds know it.
    named = () if manifest is None else manifest.trees
    further = [pattern for pattern in _extra_files() if pattern.partition("/")[0] in named]
    names = set(folder.names())
    shown = {name for name in names if name in (PENDING_FOLDER, RECORD_FILE) or name[0] != "."}
    found = [path for path in folder.walk() if path.partition("/")[0] in shown]
    strange = [path for path in found if folder.place(path) and not _is_ours(path, further)]
    # A damaged manifest of a data set has shards next to it; other programs have files of that name, too.
    if manifest is None and not {DATA_FOLDER, PENDING_FOLDER} & names:
        strange = [MANIFEST_FILE]
    if strange:
        raise InputError(
            f"{folder.address()!r} holds more than a data set of this toolkit (found {strange[0]!r}); "
            "nothing was changed",
            next="move that file away, or choose an empty or new folder (--out or OUT)",
        )
    return found


def refuse_overwriting_parts(folder: DataFolder, runner: Runner | int) -> None:
    """Raise InputError for what makes or ends parts: one must not remove what the others made."""
    if isinstance(runner, (Part, Finish)):
        raise InputError(
            "--overwrite was given with --part or --finish: each part would remove what the others made; "
            "nothing was changed",
            next=f"remove {folder.address()!r} first, or choose another folder (--out or OUT)",
        )


def _manifest(folder: DataFolder) -> Manifest | None:
    try:
        return read_manifest(folder)
    except IntegrityError:
        return None


def _extra_files() -> list[str]:
    """Return the patterns of files that some kind of data set has next to its rows."""
    return [pattern for kind in kinds() for pattern in kind.extra_files]


def _is_ours(path: str, further: list[str]) -> bool:
    """Return whether a file of a data set can have such a path."""
    place = PurePosixPath(path)
    if path.startswith(f"{PENDING_FOLDER}/") or (
        len(place.parts) > 1 and place.name.startswith(TEMPORARY_PREFIX)
    ):
        return True
    if str(place.parent) == DATA_FOLDER:
        return ShardName.parse(place.name) is not None
    # Not from the right end alone, as `match` compares.
    return any(
        place.match(pattern) and len(place.parts) == pattern.count("/") + 1 for pattern in (*_OURS, *further)
    )


def prepare_next(folder: DataFolder, plan: BuildPlan) -> DataFolder:
    """Return the folder in which the next data set is made, without files of any other one.

    The run that was making the other one, if it is still at work, is asked to begin again.
    """
    after = DataFolder(folder.address(NEXT_FOLDER))
    begun = _manifest(after)
    if begun is None or begun.identity != plan.new_manifest().identity:
        folder.remove(f"{NEXT_FOLDER}/{MANIFEST_FILE}")  # first: without it no other file counts
        folder.remove_tree(NEXT_FOLDER)
    after.require_folder()
    return after


def resume_promotion(folder: DataFolder, patience_s: float = _PATIENCE_S) -> None:
    """Complete a replacement that was begun; raises InputError while another run does so."""
    if folder.is_local and folder.exists(_PROMOTION):
        with folder.locked(patience_s=patience_s):
            if folder.exists(_PROMOTION):
                _move_files(folder)


def promote(folder: DataFolder) -> None:
    """Put the finished data set in ``.next`` in place of that around it; the caller holds the lock.

    Raises InputError where the folder holds more than a data set by now, and nothing was touched.
    """
    leave = require_replaceable(folder)
    former = sorted({*leave}.difference(_arriving(folder)))
    folder.write_bytes(_PROMOTION, msgspec.json.encode(former))  # from here on it can only be completed
    _move_files(folder)


def _arriving(folder: DataFolder) -> list[str]:
    """Return the files of the next data set that were not moved yet."""
    return [path for path in DataFolder(folder.address(NEXT_FOLDER)).walk() if not path.startswith(".")]


def _move_files(folder: DataFolder) -> None:
    leave = decode(folder.read_bytes(_PROMOTION), list[str], folder.address(_PROMOTION))
    after = DataFolder(folder.address(NEXT_FOLDER))
    manifest = read_manifest(after)
    if manifest is not None:  # it is the last file to move
        write_manifest(folder, replace(manifest, complete=False))
        # The list may be any user's, of a folder that was given to us.
        every = _extra_files()
        for path in leave:
            if _is_ours(path, every):
                folder.remove(path)
        for path in _arriving(folder):
            if path != MANIFEST_FILE:
                folder.move(f"{NEXT_FOLDER}/{path}", path)
        sizes = folder.sizes(DATA_FOLDER)
        missing = [record.shard.data_path for record in manifest.shards if not record.is_size_of(sizes)]
        if missing:
            folder.remove_tree(NEXT_FOLDER)  # the same run makes them again where they are to be
            raise IntegrityError(
                f"{folder.address(missing[0])!r} is missing or of another size, though it was made to take "
                "the place of a former file",
                next="run the same command again without --overwrite",
            )
        folder.move(f"{NEXT_FOLDER}/{MANIFEST_FILE}", MANIFEST_FILE)
    for path in leave:
        while path := path.rpartition("/")[0]:
            folder.remove_empty(path)
    folder.remove_tree(NEXT_FOLDER)
