"""Replacing a data set: the next one is made in ``.next``, then moved into its place."""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import replace

import msgspec

from tactile_toolkit.errors import InputError, IntegrityError
from tactile_toolkit.store.download_record import RECORD_FILE
from tactile_toolkit.store.files import is_hidden
from tactile_toolkit.store.folder import NEXT_FOLDER, PENDING_FOLDER, DataFolder, LocalFolder
from tactile_toolkit.store.job import refuse_unknown_files
from tactile_toolkit.store.locks import locked
from tactile_toolkit.store.manifest import MANIFEST_FILE, Manifest, read_manifest, write_manifest
from tactile_toolkit.store.owned_files import CARD_FILE, extra_files, is_ours
from tactile_toolkit.store.plan import BuildPlan
from tactile_toolkit.store.sealed_json import decode
from tactile_toolkit.store.shards import DATA_FOLDER

PROMOTION_FILE = f"{NEXT_FOLDER}/.promotion.json"
"""Lists the files of the former data set that the next one lacks."""


def require_replaceable(folder: DataFolder, plan: BuildPlan | None = None) -> list[str]:
    """Return the files of the data set that a run may replace; empty if there is none. Changes nothing.

    Files of a data set are known by their names; other hidden files stay. An interrupted run of the plan is
    continued, not replaced. Raises InputError for any other file or symbolic link, and for a set in an object
    store, where files cannot be moved.
    """
    if not folder.exists(MANIFEST_FILE):
        refuse_unknown_files(folder, plan)
        return []
    if not isinstance(folder, LocalFolder):
        raise InputError(
            f"{folder.address()!r} holds a data set, and --overwrite does not work in an object store: the "
            "data set could not be restored if the new run fails; nothing was changed",
            next="choose another folder (--out or OUT), or remove that one with the store's own tools",
        )
    manifest = _manifest(folder)
    # Anyone may have written the manifest: folders that it names count only if a kind declares them.
    named: Collection[str] = ()
    if manifest is not None:
        named = manifest.trees or ()
    further = [pattern for pattern in extra_files() if pattern.partition("/")[0] in named]
    names = set(folder.names())
    shown = {name for name in names if name in (PENDING_FOLDER, RECORD_FILE) or not is_hidden(name)}
    found = [path for path in folder.walk() if path.partition("/")[0] in shown]
    unknown = [path for path in found if folder.local_path(path) and not is_ours(path, further)]
    # Other programs use that file name, too: a damaged manifest of a data set has shards next to it.
    if manifest is None and not {DATA_FOLDER, PENDING_FOLDER} & names:
        unknown = [MANIFEST_FILE]
    if unknown:
        raise InputError(
            f"{folder.address()!r} holds more than a data set of this toolkit (found {unknown[0]!r}); "
            "nothing was changed",
            next="move that file away, or choose an empty or new folder (--out or OUT)",
        )
    return found


def _manifest(folder: DataFolder) -> Manifest | None:
    try:
        return read_manifest(folder)
    except IntegrityError:
        return None


def _next(folder: LocalFolder) -> LocalFolder:
    return LocalFolder(folder.address(NEXT_FOLDER))


def prepare_next(folder: LocalFolder, plan: BuildPlan) -> LocalFolder:
    """Return the folder in which the next data set is made, without files of any other one.

    A run holds the lock of that folder, shared with other runs of the same job. Raises BusyError if another
    data set is being made there.
    """
    after = _next(folder)
    after.require_folder()
    begun = _manifest(after)
    if begun is None or begun.identity != plan.new_manifest().identity:
        with locked(folder.local_path(NEXT_FOLDER), patience_s=0.0):
            folder.remove(f"{NEXT_FOLDER}/{MANIFEST_FILE}")  # first: without it no other file counts
            remove_next(folder)
        after.require_folder()
    return after


def keep_card(folder: LocalFolder) -> None:
    """Copy the card to the next data set, whose card keeps the statements of the owner."""
    after = _next(folder)
    if folder.exists(CARD_FILE) and not after.exists(CARD_FILE):
        after.write_bytes(CARD_FILE, folder.read_bytes(CARD_FILE))


def resume_promotion(folder: DataFolder) -> None:
    """Complete a replacement that was begun; raises BusyError while another run does so."""
    if isinstance(folder, LocalFolder) and folder.exists(PROMOTION_FILE):
        with folder.locked():
            if folder.exists(PROMOTION_FILE):
                _move_files(folder)


def promote(folder: LocalFolder) -> None:
    """Move the finished data set in ``.next`` into its place; the caller holds the lock.

    Raises InputError if the folder holds more than a data set by now; then nothing was changed.
    """
    former = sorted({*require_replaceable(folder)}.difference(_arriving(folder)))
    # From here on, the replacement can only be completed.
    folder.write_bytes(PROMOTION_FILE, msgspec.json.encode(former))
    _move_files(folder)


def _arriving(folder: LocalFolder) -> list[str]:
    """Return the files of the next data set that have not been moved yet."""
    return [path for path in _next(folder).walk() if not is_hidden(path)]


def _move_files(folder: LocalFolder) -> None:
    former = decode(folder.read_bytes(PROMOTION_FILE), list[str], folder.address(PROMOTION_FILE))
    manifest = read_manifest(_next(folder))
    if manifest is not None:  # it is the last file to move
        write_manifest(folder, replace(manifest, complete=False))
        # Anyone may have written the list: the folder may be a copy of another user's.
        further = extra_files()
        for path in former:
            if is_ours(path, further):
                folder.remove(path)
        for path in _arriving(folder):
            if path != MANIFEST_FILE:
                folder.move(f"{NEXT_FOLDER}/{path}", path)
        sizes = folder.sizes(DATA_FOLDER)
        missing = [record.shard.data_path for record in manifest.shards if not record.is_size_of(sizes)]
        if missing:
            remove_next(folder)  # the same run makes them again in their place
            raise IntegrityError(
                f"{folder.address(missing[0])!r} is missing or has another size, though it was made to "
                "replace a former file",
                next="run the same command again without --overwrite",
            )
        folder.move(f"{NEXT_FOLDER}/{MANIFEST_FILE}", MANIFEST_FILE)
    for path in former:
        while path := path.rpartition("/")[0]:
            folder.remove_empty(path)
    remove_next(folder)


def remove_next(folder: LocalFolder) -> None:
    """Remove the data set in ``.next``."""
    if folder.exists(NEXT_FOLDER):
        further = extra_files()
        folder.remove_tree(
            NEXT_FOLDER,
            lambda path: path == PROMOTION_FILE or is_ours(path.removeprefix(f"{NEXT_FOLDER}/"), further),
        )
