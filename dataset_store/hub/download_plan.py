"""What a download has to do, decided before anything is fetched or removed."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path, PurePosixPath

from dataset_store.cards.card import CARD_FILE
from dataset_store.errors import HubError, SpecMismatchError
from dataset_store.hub.checks import is_whole
from dataset_store.hub.download_record import DownloadRecord, read_record
from dataset_store.hub.published import published_set
from dataset_store.hub.repository import HubRepository
from dataset_store.hub.retries import could_not_ask
from dataset_store.hub.snapshot import HubFile
from dataset_store.manifest import MANIFEST_FILE
from dataset_store.places import files_of_split, repository_named, repository_shards, shard_files
from dataset_store.shards import DATA_FOLDER
from dataset_store.storage import DataFolder

__all__ = ["DownloadPlan", "labels_of", "plan_download"]

_EXTRA_FOLDERS = ("reports", "previews")
_EXTRA_FILES = ("LICENSE", "LICENSE.md", "LICENSE.txt")


@dataclass(frozen=True, slots=True)
class DownloadPlan:
    """What is wanted, what of it is here, and what must go.

    Attributes
    ----------
    repository : HubRepository
        Where from.
    folder : DataFolder or None
        Where to; None for the Hub's own cache.
    commit : str
        Commit that all files are of.
    splits : tuple of str
        Splits that will be there.
    all_splits : tuple of str
        Splits of the repository.
    files : tuple of HubFile
        All files wanted, but for card and manifest of a folder, which are fitted to its splits.
    missing : tuple of HubFile
        Those of them that are to be fetched.
    leftover : tuple of str
        Files of an earlier download that the repository has no more.
    is_done : bool
        Whether there is nothing to do at all.
    """

    repository: HubRepository
    folder: DataFolder | None
    commit: str
    splits: tuple[str, ...]
    all_splits: tuple[str, ...]
    files: tuple[HubFile, ...]
    missing: tuple[HubFile, ...]
    leftover: tuple[str, ...]
    is_done: bool

    @property
    def bytes(self) -> int:
        """Size of all files wanted."""
        return sum(file.size_bytes for file in self.files)

    @property
    def missing_bytes(self) -> int:
        """Size of the files to be fetched."""
        return sum(file.size_bytes for file in self.missing)


def plan_download(
    name: str, splits: Sequence[str] = (), *, revision: str | None = None, out: str | None = None
) -> DownloadPlan:
    """Find out what a download has to do; changes nothing in the target.

    Parameters
    ----------
    name : str
        Short name of a published set, or ``USER/NAME``.
    splits : sequence of str
        Splits wanted; none means all. Splits that are in the folder already stay in step with them.
    revision : str, optional
        Branch, tag or commit.
    out : str, optional
        Folder to fill instead of the Hub's cache.

    Raises
    ------
    InputError
        No name of a repository, or no such split.
    SpecMismatchError
        The folder holds another data set.
    HubError
        The Hub refuses, or cannot be reached while something is missing.
    """
    known = published_set(name)
    repository = repository_named(known.repo_id if known else name, revision)
    if out is None:
        return _plan_for_cache(repository, splits)
    folder = DataFolder(out)
    record = _own_record(folder, repository)
    done = _already_done(repository, folder, record, splits)
    return done or _plan_for_folder(repository, folder, record, splits)


def _plan_for_cache(repository: HubRepository, splits: Sequence[str]) -> DownloadPlan:
    chosen, all_splits, shards = _chosen(repository, splits)
    files = tuple(_file(repository, path) for path in [*_extras(repository, fitted=True), *shards])
    missing = tuple(file for file in files if repository.cached(file.path) is None)
    commit = repository.snapshot.commit
    return DownloadPlan(repository, None, commit, chosen, all_splits, files, missing, (), not missing)


def _plan_for_folder(
    repository: HubRepository, folder: DataFolder, record: DownloadRecord | None, splits: Sequence[str]
) -> DownloadPlan:
    now = {file.split for file in repository_shards(repository)}
    before = [file.split for file in shard_files(record.files)] if record else []
    wanted = [*splits, *(split for split in before if split in now)] if splits else []
    chosen, all_splits, shards = _chosen(repository, wanted)
    files = tuple(_file(repository, path) for path in [*_extras(repository, fitted=False), *shards])
    missing = tuple(file for file in files if not _is_here(folder, file))
    paths = {file.path for file in files}
    leftover = tuple(path for path in (record.files if record else ()) if path not in paths)
    commit = repository.snapshot.commit
    same = record is not None and record.commit == commit and not leftover and not missing
    done = same and _is_labelled(folder, labels_of(repository))
    return DownloadPlan(repository, folder, commit, chosen, all_splits, files, missing, leftover, done)


def labels_of(repository: HubRepository) -> tuple[str, ...]:
    """Return which of card and manifest a repository has."""
    return tuple(name for name in (CARD_FILE, MANIFEST_FILE) if name in repository.snapshot.files)


def _is_labelled(folder: DataFolder, labels: Iterable[str]) -> bool:
    return all(folder.exists(name) for name in labels)


def _already_done(
    repository: HubRepository, folder: DataFolder, record: DownloadRecord | None, splits: Sequence[str]
) -> DownloadPlan | None:
    """Return a plan with nothing to do when the Hub cannot be asked, but all that is wanted is there."""
    try:
        if not repository.snapshot.is_cache:
            return None
    except HubError as error:
        done = _plan_by_record(repository, folder, record, splits)
        if done is None or not could_not_ask(error):
            raise
        return done
    return _plan_by_record(repository, folder, record, splits)


def _plan_by_record(
    repository: HubRepository, folder: DataFolder, record: DownloadRecord | None, splits: Sequence[str]
) -> DownloadPlan | None:
    if record is None or record.revision != repository.revision or not _is_labelled(folder, record.labels):
        return None
    here = {file.split for file in shard_files(record.files)}
    files = tuple(record.files.values())
    if not set(splits or record.splits) <= here or not all(_is_here(folder, file) for file in files):
        return None
    chosen = tuple(split for split in record.splits if split in here)
    return DownloadPlan(repository, folder, record.commit, chosen, record.splits, files, (), (), True)


def _own_record(folder: DataFolder, repository: HubRepository) -> DownloadRecord | None:
    """Return the record of an earlier download of the same repository.

    Raises
    ------
    SpecMismatchError
        The folder holds something else.
    """
    record = read_record(folder)
    if record is not None and record.repo_id == repository.repo_id:
        return record
    found = f"a download of {record.repo_id!r}" if record is not None else "a data set of another origin"
    if record is not None or folder.exists(MANIFEST_FILE) or folder.names(DATA_FOLDER):
        message = (
            f"{folder.address()!r} holds {found}, not one of {repository.repo_id!r}; nothing in it was "
            "changed; next: choose another folder with --out"
        )
        raise SpecMismatchError(message)
    return None


def _chosen(
    repository: HubRepository, splits: Sequence[str]
) -> tuple[tuple[str, ...], tuple[str, ...], list[str]]:
    """Return the splits wanted, all splits, and the paths of the shards wanted."""
    found = repository_shards(repository)
    order = repository.manifest.split_order if repository.manifest is not None else ()
    names = {file.split for file in found}
    known = tuple(split for split in order if split in names) or tuple(sorted(names))
    chosen = tuple(split for split in known if split in splits) if splits else known
    shards = []
    for split in dict.fromkeys([*chosen, *splits] or ["train"]):
        with repository.told_apart(f"split {split!r}"):
            shards += [file.path for file in files_of_split(found, split, repository.repo_id)]
    return chosen, known, shards


def _extras(repository: HubRepository, *, fitted: bool) -> list[str]:
    """Return the small files that go with every split; card and manifest only when taken as they are."""
    manifest = repository.manifest
    listed = set(manifest.files or ()) if manifest is not None else set()
    return [path for path in repository.files() if _is_extra(path, listed, fitted)]


def _is_extra(path: str, listed: set[str], fitted: bool) -> bool:
    if path in (CARD_FILE, MANIFEST_FILE):
        return fitted
    return path in listed or path in _EXTRA_FILES or PurePosixPath(path).parts[0] in _EXTRA_FOLDERS


def _file(repository: HubRepository, path: str) -> HubFile:
    """Return a wanted file with what proves it: the manifest's checksum, or else the Hub's."""
    return HubFile(path, repository.size_bytes(path), repository.expected(path))


def _is_here(folder: DataFolder, file: HubFile) -> bool:
    place = Path(folder.address(file.path))
    if not place.is_file() or place.stat().st_size != file.size_bytes or file.digest is None:
        return False
    return is_whole(place, file.digest)
