"""Downloading data sets of the Hub: only the splits wanted, every file checked, into the cache or a folder.

First everything is looked at and nothing is changed (:func:`plan_download`); then the plan is carried out
(:func:`download`).
"""

from __future__ import annotations

import contextlib
import shutil
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path, PurePosixPath

from tactile_toolkit.cards.card import CARD_FILE
from tactile_toolkit.cards.croissant import CROISSANT_FILE, croissant_of_folder
from tactile_toolkit.cards.facts import folder_facts, viewer_files
from tactile_toolkit.cards.head import configs, dataset_info, head_text, size_category
from tactile_toolkit.catalog.locate import repository_named, repository_shards
from tactile_toolkit.catalog.published import published_set
from tactile_toolkit.errors import (
    HubError,
    InputError,
    IntegrityError,
    SpecMismatchError,
    StorageError,
    ToolkitError,
)
from tactile_toolkit.hub.cache import matches_digest, snapshot_folder
from tactile_toolkit.hub.calls import is_unanswered
from tactile_toolkit.hub.errors import not_cached, storage_failure_as_hub_error
from tactile_toolkit.hub.repository import HubRepository, Transfers, cached_snapshot
from tactile_toolkit.run.system import locked
from tactile_toolkit.run.threads import in_threads
from tactile_toolkit.store.files import scratch_folder
from tactile_toolkit.store.folder import DataFolder
from tactile_toolkit.store.job import refuse_unknown_files
from tactile_toolkit.store.manifest import MANIFEST_FILE, Manifest, read_manifest, write_manifest
from tactile_toolkit.store.names import names_inside
from tactile_toolkit.store.origin import DownloadRecord, HubFile, read_record, write_record
from tactile_toolkit.store.shards import DATA_FOLDER, files_of_split, shard_files

# What is fitted to the splits that a folder gets.
_METADATA_FILES = (CARD_FILE, MANIFEST_FILE, CROISSANT_FILE)

_EXTRA_FOLDERS = ("reports", "previews")
_EXTRA_FILES = ("LICENSE", "LICENSE.md", "LICENSE.txt")
_PICTURE_FOLDER = "images"
# Where the Hub's client keeps what it has not fetched to the end.
_STAGE_FOLDER = ".cache/huggingface"
_THREADS = 8
_FENCE = "---\n"


@dataclass(frozen=True, slots=True)
class DownloadPlan:
    """What is wanted, what of it is here, and what must go.

    Attributes
    ----------
    repository : HubRepository
        Where from.
    folder : DataFolder or None
        Where to; None for the Hub's own cache.
    splits : tuple of str
        Splits that will be there.
    missing : tuple of HubFile
        Files that are to be fetched.
    leftover : tuple of str
        Files of an earlier download that the repository has no more; they are removed. Empty where the Hub
        gives no answer: what is not known here may well be there.
    is_done : bool
        Whether there is nothing to do at all.
    record : DownloadRecord
        What a folder is to record when all is done. Its files are all that are wanted, but for cards and
        manifest of a folder, which are fitted to its splits.
    earlier : DownloadRecord or None
        What the folder recorded when the plan was made.
    """

    repository: HubRepository
    folder: DataFolder | None
    splits: tuple[str, ...]
    missing: tuple[HubFile, ...]
    leftover: tuple[str, ...]
    is_done: bool
    record: DownloadRecord
    earlier: DownloadRecord | None

    @property
    def missing_bytes(self) -> int:
        """Size of the files to be fetched."""
        return sum(file.size_bytes for file in self.missing)

    @property
    def manifest(self) -> Manifest | None:
        """Manifest of the data set; None where there is no manifest."""
        return read_manifest(self.folder) if self.is_done and self.folder else self.repository.manifest


@storage_failure_as_hub_error()
def plan_download(
    name: str,
    splits: Sequence[str] = (),
    *,
    revision: str | None = None,
    out: str | None = None,
    on_wait: Callable[[str], None] = lambda _: None,
) -> DownloadPlan:
    """Find out what a download has to do; changes nothing in the target.

    ``name`` is a short name of a published set, or ``USER/NAME``; ``out`` a folder to fill instead of the
    Hub's cache. No split named means all; splits that are in the folder already stay in step with them. A
    Hub in trouble is waited for; in place of one that stays silent the cache and the folder's record answer.
    Raises InputError (not a repository, no such split, a user's own files in the folder),
    SpecMismatchError (the folder holds another data set) or HubError; then nothing in the folder was touched.
    """
    known = published_set(name)
    repository = repository_named(known.repo_id if known else name, revision)
    folder = DataFolder(out) if out is not None else None
    return _plan(replace(repository, patient=True, on_wait=on_wait), splits, folder)


def _plan(repository: HubRepository, splits: Sequence[str], folder: DataFolder | None) -> DownloadPlan:
    earlier = _own_record(folder, repository) if folder is not None else None
    repository = _answered(repository, earlier)
    snapshot, recorded = repository.snapshot, earlier.files if earlier else {}
    # In place of a silent Hub: all that the record lists stays wanted.
    known = earlier if snapshot.is_cache else None
    shards = repository_shards(repository)
    there, order = dict.fromkeys(sorted(shard.split for shard in shards)), repository.manifest
    listed = [split for split in order.split_order if split in there] if order is not None else []
    all_splits = known.splits if known else tuple(listed or there)
    before = {shard.split for shard in shard_files(recorded)}
    wanted = {*splits, *before} if splits or known else set(all_splits)
    chosen = tuple(split for split in all_splits if split in wanted and split in there)
    paths = [*_extras(repository, chosen, fitted=folder is None), *(known.files if known else ())]
    # Of a repository without shards, the usual split is reported missing.
    for split in dict.fromkeys([*chosen, *splits] or ["train"]):
        with repository.missing_as_not_cached(f"split {split!r}"):
            paths += [file.path for file in files_of_split(shards, split, repository.repo_id)]
    names = names_inside(dict.fromkeys(paths), f"Hub data set {repository.repo_id!r}")
    files = {path: repository.file(path) for path in names}

    def is_here(file: HubFile) -> bool:
        """Return whether a file lies intact where it is to be, read again: a flipped bit changes no time."""
        path, digest = file.path, file.digest
        if folder is None:
            return repository.cached(path, force=True) is not None
        if digest is None or not folder.exists(path) or folder.size_bytes(path) != file.size_bytes:
            return False
        if folder.is_local:
            return matches_digest(Path(folder.address(path)), digest, force=True)
        # A store changes no bit by itself: what a finished download wrote there is known by its size.
        if earlier is not None and earlier.finished and recorded.get(path) == file:
            return True
        with folder.open(path) as stream:
            return digest.of_stream(stream, file.size_bytes) == digest

    here = in_threads(is_here, files.values(), _THREADS)
    missing = [file for file, is_intact in zip(files.values(), here, strict=True) if not is_intact]
    leftover = [path for path in recorded if path not in files]
    # Other tools write manifests too, which are none of a data set of ours.
    described = [path for path in _METADATA_FILES if path != MANIFEST_FILE or repository.manifest]
    metadata = known.labels if known else tuple(path for path in described if path in snapshot.files)
    origin = (repository.repo_id, snapshot.commit, repository.revision)
    record = DownloadRecord(*origin, files, all_splits, metadata)
    is_done = not missing
    if folder is not None:
        _refuse_own_files(folder, [file.path for file in missing])
        same = earlier is not None and earlier.finished and earlier.commit == snapshot.commit
        is_done = same and not missing and not leftover and _has_metadata(folder, metadata)
    if snapshot.is_cache and not is_done:  # found out before anything is touched
        for path in (*(file.path for file in missing), *metadata):
            if path not in snapshot.files or repository.cached(path) is None:
                raise not_cached(repository.repo_id, repr(path))
    todo = (tuple(missing), tuple(leftover), is_done)
    return DownloadPlan(repository, folder, chosen, *todo, record, earlier)


def _answered(repository: HubRepository, record: DownloadRecord | None) -> HubRepository:
    """Return the repository with what it holds: as the Hub says, or else as cache and record do.

    The record of a folder can be repaired and added to by the cache; neither says what the Hub has no more.
    """
    commit = ""
    try:
        if record is None or not repository.snapshot.is_cache:
            return repository
        commit = repository.snapshot.commit
    except HubError as error:
        # A refusal counts, whatever is here.
        if record is None or not is_unanswered(error):
            raise
    # Only the Hub knows whether two names mean one commit.
    if repository.revision != record.revision and commit != record.commit:
        raise not_cached(repository.repo_id, f"commit {record.commit[:12]}, which the folder holds,")
    cached = cached_snapshot(repository.repo_id, record.commit)
    return replace(repository, known=replace(cached, files={**cached.files, **record.files}))


def _own_record(folder: DataFolder, repository: HubRepository) -> DownloadRecord | None:
    """Return the record of an earlier download of the same repository; refuse a folder of anything else."""
    # What is there before the record of it: a download that begins meanwhile writes its record first.
    holds_set, names = folder.exists(MANIFEST_FILE) or bool(folder.names(DATA_FOLDER)), folder.names()
    record = read_record(folder)
    if record is not None and record.repo_id == repository.repo_id:
        return record
    if record is not None or holds_set:
        found = f"a download of {record.repo_id!r}" if record is not None else "a data set of another origin"
        raise SpecMismatchError(
            f"{folder.address()!r} holds {found}, not one of {repository.repo_id!r}; nothing in it was "
            "changed",
            next="choose another folder with --out",
        )
    if names:
        refuse_unknown_files(folder)
    return None


def _refuse_own_files(folder: DataFolder, paths: Iterable[str]) -> None:
    """Refuse to write over what no download has brought."""
    own = [path for path in paths if folder.exists(path)]
    # Read after the look at the files: another download may have brought them just now.
    record = read_record(folder) if own else None
    own = [path for path in own if record is None or path not in record.files]
    if own:
        raise InputError(
            f"{folder.address()!r} holds a file of your own where the data set has one ({own[0]!r}); nothing "
            "was changed",
            next="move it away, or choose another folder with --out",
        )


def _extras(repository: HubRepository, splits: Sequence[str], *, fitted: bool) -> list[str]:
    """Return what goes with the shards of some splits: small files, and pictures where the set has any.

    With ``fitted``, cards and manifest too, as they are.
    """
    manifest = repository.manifest
    listed = set(manifest.files or ()) if manifest is not None else set()
    shown = {path for paths in viewer_files(manifest).values() for path in paths}

    def is_extra(path: str) -> bool:
        if path in _METADATA_FILES:
            return fitted
        if path in shown:  # repeats the shards for the Hub's page, and stays there
            return False
        return path in listed or path in _EXTRA_FILES or PurePosixPath(path).parts[0] in _EXTRA_FOLDERS

    found = [path for path in repository.files() if is_extra(path)]
    if manifest is None:
        return found
    # Data sets of plain pictures name them in their rows: without the files, those are names of nothing.
    folders = tuple(f"{_PICTURE_FOLDER}/{split}/" for split in splits)
    return [*found, *(path for path in repository.files() if path.startswith(folders))]


def _has_metadata(folder: DataFolder, paths: Iterable[str]) -> bool:
    """Return whether a folder has its card, and a manifest that states that nothing is left to do."""
    with contextlib.suppress(IntegrityError):
        manifest = read_manifest(folder)
        return all(map(folder.exists, paths)) and (manifest is None or manifest.complete)
    return False


@storage_failure_as_hub_error()
def download(plan: DownloadPlan, on_progress: Callable[[int, int], None] = lambda _done, _total: None) -> str:
    """Carry out a plan and return the folder that holds the files: that of a commit in the cache, or its own.

    ``on_progress`` gets the bytes that have arrived and the bytes in all. Raises IntegrityError (a file
    arrived damaged twice; nothing of it is kept, intact files are), HubError (the same call continues)
    or StorageError, with the exit code of HubError.
    """
    repository, folder = plan.repository, plan.folder
    _require_space(plan)
    transfers = Transfers(lambda done: on_progress(done, plan.missing_bytes))
    if folder is None:
        repository.fetch([file.path for file in plan.missing], transfers)
        return str(snapshot_folder(repository.repo_id, plan.record.commit))
    if not plan.is_done:
        with _alone(folder, repository.on_wait):
            if read_record(folder) != plan.earlier:  # another download was here, maybe of other splits
                plan = _plan(repository, plan.splits, folder)
            if not plan.is_done:
                _execute(plan, folder, transfers)
    return folder.address()


@contextlib.contextmanager
def _alone(folder: DataFolder, on_wait: Callable[[str], None]) -> Iterator[None]:
    """Keep other downloads on this machine out of a folder, and wait for one that is at work there."""
    folder.require_folder()
    with contextlib.ExitStack() as stack:
        if folder.is_local:
            place = Path(folder.address())
            try:
                stack.enter_context(locked(place, patience_s=0))
            except BlockingIOError:
                on_wait(f"another download fills {str(place)!r}; this one begins when that one has ended")
                stack.enter_context(locked(place))
        yield


def _require_space(plan: DownloadPlan) -> None:
    from huggingface_hub import constants

    # A store has no end.
    if plan.folder is not None and not plan.folder.is_local:
        return
    target = Path(plan.folder.address() if plan.folder else constants.HF_HUB_CACHE)
    there = next(path for path in (target, *target.absolute().parents) if path.exists())
    free = shutil.disk_usage(there).free
    if plan.missing_bytes > free:
        raise StorageError(
            f"{plan.missing_bytes:,} bytes are to be fetched, and {str(there)!r} has room for {free:,}; "
            "nothing was fetched",
            next="free some space, or choose another place with --out or HF_HOME",
        )


def _execute(plan: DownloadPlan, folder: DataFolder, transfers: Transfers) -> None:
    """Bring a folder to the commit of the plan; a reader never takes a mixture for a finished data set."""
    repository, manifest, record = plan.repository, plan.repository.manifest, plan.record
    if folder.is_local:  # refused before anything changes: a link leads to what is not of this folder
        for path in (_STAGE_FOLDER, MANIFEST_FILE, *plan.leftover, *record.files):
            folder.place(path)
    folder.remove_temporaries()
    # What the folder is to become is written down first, so that a killed download is known for what it is.
    earlier = plan.earlier.files if plan.earlier else {}
    write_record(folder, replace(record, files={**earlier, **record.files}, finished=False))
    if manifest is not None and (plan.missing or plan.leftover):
        write_manifest(folder, replace(manifest, shards=(), complete=False))
    # Before the first new file comes: old and new ones next to each other would pass for one set.
    for path in (*plan.leftover, *(file.path for file in plan.missing)):
        folder.remove(path)

    with contextlib.ExitStack() as stack:
        stage = Path(folder.address()) if folder.is_local else stack.enter_context(scratch_folder())

        def fetch_file(file: HubFile) -> None:
            """Bring one file into the folder: a copy where the Hub's cache has it intact, or fetched."""
            cached = repository.cached(file.path)
            place = cached or repository.download(file.path, transfers, stage)
            if cached is not None or not folder.is_local:
                folder.copy_in(file.path, place)
                transfers.count(file.path, file.size_bytes)
            if cached is None and not folder.is_local:
                place.unlink()

        transfers.each(fetch_file, plan.missing)
    _write_metadata(plan, folder, manifest)
    write_record(folder, record)
    if folder.is_local:
        folder.remove_tree(_STAGE_FOLDER)
        folder.remove_empty(str(PurePosixPath(_STAGE_FOLDER).parent))


def _write_metadata(plan: DownloadPlan, folder: DataFolder, manifest: Manifest | None) -> None:
    """Write manifest and cards, fitted to the splits that are there."""
    is_part, names = set(plan.splits) < set(plan.record.splits), plan.record.labels
    found = [Path(path).read_bytes() for path in plan.repository.fetch(names)]
    contents = dict(zip(names, found, strict=True))
    shown = {path for paths in viewer_files(manifest).values() for path in paths}
    is_fitted = is_part or bool(shown)
    if manifest is not None and is_fitted:
        records = [record for record in manifest.shards if record.shard.split in plan.splits]
        files = {path: digest for path, digest in (manifest.files or {}).items() if path not in shown}
        fitted = replace(manifest, shards=tuple(records), files=files)
        contents[MANIFEST_FILE] = fitted.to_json().encode()
    # In this order: the card is fitted to what the manifest lists, and Croissant describes both.
    if manifest is not None:
        folder.write_bytes(MANIFEST_FILE, contents[MANIFEST_FILE])
    if CARD_FILE in contents:
        card = contents[CARD_FILE]
        folder.write_bytes(CARD_FILE, _fitted_card(card, plan, folder, is_part) if is_fitted else card)
    if CROISSANT_FILE in contents:
        content = contents[CROISSANT_FILE]
        with contextlib.suppress(ToolkitError, ValueError, RecursionError):  # a user's own stays as it is
            if manifest is not None:
                content = croissant_of_folder(content.decode(), folder).encode()
        folder.write_bytes(CROISSANT_FILE, content)


def _fitted_card(content: bytes, plan: DownloadPlan, folder: DataFolder, is_part: bool) -> bytes:
    """Return a card whose YAML head names what is here, with a note in front of its text.

    A card without a head that can be read is left as it is. Shards and manifest must be in place.
    """
    # ``datasets.load_dataset(folder)`` fails over a split that the head names and the folder lacks.
    import yaml

    try:
        start, text, body = content.decode().split(_FENCE, 2)
        head, facts = yaml.safe_load(text), folder_facts(folder)
        head["configs"] = configs(facts)
        if "size_categories" in head:
            head["size_categories"] = [size_category(facts.rows)]
        if "dataset_info" in head:
            head["dataset_info"] = dataset_info(facts)
    except (ValueError, TypeError, yaml.YAMLError, RecursionError, ToolkitError):
        return content
    if start:
        return content
    here = ", ".join(f"`{split}`" for split in plan.splits)
    note = (
        f"\n> This folder holds {here} of `{plan.repository.repo_id}` (commit `{plan.record.commit[:12]}`); "
        "the text below describes the whole data set.\n\n"
    )
    return (head_text(head) + (note if is_part else "") + body).encode()
