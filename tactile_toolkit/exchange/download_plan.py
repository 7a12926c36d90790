"""What a download has to do, decided before anything is fetched or removed."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path, PurePosixPath

from tactile_toolkit.cards.card import CARD_FILE
from tactile_toolkit.catalog.locate import files_of_split, repository_named, repository_shards, shard_files
from tactile_toolkit.catalog.published import published_set
from tactile_toolkit.errors import HubError, IntegrityError, SpecMismatchError, ToolkitError
from tactile_toolkit.hub.errors import ends_a_download, not_cached
from tactile_toolkit.hub.fetch import is_whole
from tactile_toolkit.hub.repository import HubRepository
from tactile_toolkit.hub.retry import could_not_ask
from tactile_toolkit.store.folder import DataFolder
from tactile_toolkit.store.manifest import MANIFEST_FILE, Manifest, read_manifest
from tactile_toolkit.store.origin import DownloadRecord, HubFile, read_record
from tactile_toolkit.store.plan import refuse_unknown_files
from tactile_toolkit.store.shards import DATA_FOLDER

__all__ = [
    "DownloadPlan",
    "chosen_splits",
    "extras",
    "is_here",
    "is_labelled",
    "labels_of",
    "plan_download",
    "require_within_reach",
    "wanted_file",
]

_EXTRA_FOLDERS = ("reports", "previews")
_EXTRA_FILES = ("LICENSE", "LICENSE.md", "LICENSE.txt")
_PICTURE_FOLDER = "images"


def chosen_splits(
    repository: HubRepository, splits: Sequence[str]
) -> tuple[tuple[str, ...], tuple[str, ...], list[str]]:
    """Return the splits wanted (all, where none is named), all splits, and the paths of the shards wanted."""
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


def extras(repository: HubRepository, splits: Sequence[str], *, fitted: bool) -> list[str]:
    """Return what goes with the shards of some splits: small files, and pictures where the set has any.

    Parameters
    ----------
    repository : HubRepository
        Where from.
    splits : sequence of str
        Splits wanted.
    fitted : bool
        Take card and manifest too, as they are.
    """
    manifest = repository.manifest
    listed = set(manifest.files or ()) if manifest is not None else set()
    found = [path for path in repository.files() if _is_extra(path, listed, fitted)]
    if manifest is None:
        return found
    # Data sets of plain pictures name them in their rows: without the files, those are names of nothing.
    trees = tuple(f"{_PICTURE_FOLDER}/{split}/" for split in splits)
    return [*found, *(path for path in repository.files() if path.startswith(trees))]


def _is_extra(path: str, listed: set[str], fitted: bool) -> bool:
    if path in (CARD_FILE, MANIFEST_FILE):
        return fitted
    return path in listed or path in _EXTRA_FILES or PurePosixPath(path).parts[0] in _EXTRA_FOLDERS


def wanted_file(repository: HubRepository, path: str) -> HubFile:
    """Return a wanted file with what proves it: the manifest's checksum, or else the Hub's."""
    return HubFile(path, repository.size_bytes(path), repository.expected(path))


def is_here(folder: DataFolder, file: HubFile) -> bool:
    """Tell whether a folder holds a file, whole."""
    place = Path(folder.address(file.path))
    if not place.is_file() or place.stat().st_size != file.size_bytes or file.digest is None:
        return False
    return is_whole(place, file.digest)


def labels_of(repository: HubRepository) -> tuple[str, ...]:
    """Return which of card and manifest a repository has."""
    return tuple(name for name in (CARD_FILE, MANIFEST_FILE) if name in repository.snapshot.files)


def is_labelled(folder: DataFolder, labels: Iterable[str]) -> bool:
    """Tell whether a folder has its card, and a manifest that says that nothing is left to do."""
    if not all(folder.exists(name) for name in labels):
        return False
    try:
        manifest = read_manifest(folder)
    except IntegrityError:
        return False
    return manifest is None or manifest.complete


def require_within_reach(repository: HubRepository, paths: Iterable[str]) -> None:
    """Make sure, before anything is touched, that the cache has what is wanted when it answers for the Hub.

    Raises
    ------
    HubError
        It lacks a file, and the Hub cannot be asked; names the file.
    """
    if not repository.snapshot.is_cache:
        return
    for path in paths:
        if repository.cached(path) is None:
            raise not_cached(repository.repo_id, repr(path))


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
        Files of an earlier download that the repository has no more; they are removed. None where the cache
        answers for the Hub: what it does not list may well be there.
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

    @property
    def manifest(self) -> Manifest | None:
        """Manifest of the data set; None where it has none."""
        return read_manifest(self.folder) if self.is_done and self.folder else self.repository.manifest


@ends_a_download()
def plan_download(
    name: str,
    splits: Sequence[str] = (),
    *,
    revision: str | None = None,
    out: str | None = None,
    on_wait: Callable[[str], None] = lambda _: None,
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
    on_wait : callable
        Told, in a sentence, why there is a wait.

    Raises
    ------
    InputError
        No name of a repository, no such split, or the folder holds somebody's own files.
    SpecMismatchError
        The folder holds another data set.
    HubError
        The Hub refuses, or cannot be reached while something is missing; nothing in the folder was touched.
    """
    known = published_set(name)
    repository = replace(repository_named(known.repo_id if known else name, revision), on_wait=on_wait)
    try:
        return _plan(repository, splits, out)
    except ToolkitError:
        if not repository.may_answer_later:
            raise
    # What the cache cannot give is worth waiting for a Hub in trouble.
    return _plan(replace(repository, insists=True), splits, out)


def _plan(repository: HubRepository, splits: Sequence[str], out: str | None) -> DownloadPlan:
    if out is None:
        return _plan_for_cache(repository, splits)
    folder = DataFolder(out)
    record = _own_record(folder, repository)
    done = _already_done(repository, folder, record, splits)
    if done is not None:
        return done
    if record is not None and repository.snapshot.is_cache:
        return _plan_by_cache(repository, folder, record, splits)
    return _plan_for_folder(repository, folder, record, splits)


def _plan_for_cache(repository: HubRepository, splits: Sequence[str]) -> DownloadPlan:
    _require_all_known(repository, splits)
    chosen, all_splits, shards = chosen_splits(repository, splits)
    paths = [*extras(repository, chosen, fitted=True), *shards]
    files = tuple(wanted_file(repository, path) for path in paths)
    missing = tuple(file for file in files if repository.cached(file.path) is None)
    require_within_reach(repository, [file.path for file in missing])
    commit = repository.snapshot.commit
    return DownloadPlan(repository, None, commit, chosen, all_splits, files, missing, (), not missing)


def _plan_for_folder(
    repository: HubRepository, folder: DataFolder, record: DownloadRecord | None, splits: Sequence[str]
) -> DownloadPlan:
    _require_all_known(repository, splits)
    now = {file.split for file in repository_shards(repository)}
    before = [file.split for file in shard_files(record.files)] if record else []
    wanted = [*splits, *(split for split in before if split in now)] if splits else []
    chosen, all_splits, shards = chosen_splits(repository, wanted)
    paths = [*extras(repository, chosen, fitted=False), *shards]
    files = tuple(wanted_file(repository, path) for path in paths)
    missing = tuple(file for file in files if not is_here(folder, file))
    leftover = tuple(path for path in (record.files if record else ()) if path not in set(paths))
    labels, commit = labels_of(repository), repository.snapshot.commit
    require_within_reach(repository, [*(file.path for file in missing), *labels])
    same = record is not None and record.finished and record.commit == commit
    done = same and not leftover and not missing and is_labelled(folder, labels)
    return DownloadPlan(repository, folder, commit, chosen, all_splits, files, missing, leftover, done)


def _require_all_known(repository: HubRepository, splits: Sequence[str]) -> None:
    """Refuse to take what the cache lists for all that there is, while the Hub may still answer.

    Raises
    ------
    HubError
        No split is named, and no manifest tells which ones there are.
    """
    if splits or repository.insists or repository.manifest is not None or not repository.may_answer_later:
        return
    message = f"the Hub does not say now which splits {repository.repo_id!r} has; next: try again later"
    raise HubError(message)


def _plan_by_cache(
    repository: HubRepository, folder: DataFolder, record: DownloadRecord, splits: Sequence[str]
) -> DownloadPlan:
    """Plan for a folder while the cache answers for the Hub: it can mend and add, never tell what is gone.

    Raises
    ------
    HubError
        The cache lacks something, or knows another commit than that of the folder; nothing was touched.
    """
    if repository.snapshot.commit != record.commit:
        what = f"commit {record.commit[:12]}, which {folder.address()!r} holds,"
        raise not_cached(repository.repo_id, what)
    here = {file.split for file in shard_files(record.files)}
    further = [split for split in splits if split not in here]
    files = dict(record.files)
    if further:
        paths = [*extras(repository, further, fitted=False), *chosen_splits(repository, further)[2]]
        files |= {path: wanted_file(repository, path) for path in paths}
    missing = tuple(file for file in files.values() if not is_here(folder, file))
    require_within_reach(repository, [*(file.path for file in missing), *record.labels])
    chosen = tuple(split for split in record.splits if split in {*here, *further})
    return DownloadPlan(
        repository, folder, record.commit, chosen, record.splits, tuple(files.values()), missing, (), False
    )


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
    if record is None or not record.finished or record.revision != repository.revision:
        return None
    here = {file.split for file in shard_files(record.files)}
    files = tuple(record.files.values())
    if not set(splits or record.splits) <= here or not is_labelled(folder, record.labels):
        return None
    if not all(is_here(folder, file) for file in files):
        return None
    chosen = tuple(split for split in record.splits if split in here)
    return DownloadPlan(repository, folder, record.commit, chosen, record.splits, files, (), (), True)


def _own_record(folder: DataFolder, repository: HubRepository) -> DownloadRecord | None:
    """Return the record of an earlier download of the same repository.

    Raises
    ------
    SpecMismatchError
        The folder holds another data set.
    InputError
        The folder holds something else; nothing in it was touched.
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
    refuse_unknown_files(folder)
    return None
