"""Downloading data sets from the Hub: chosen splits, every file checked, into the cache or a folder.

:meth:`DownloadPlan.of` compares everything and changes nothing; :meth:`DownloadPlan.run` carries it out.
"""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial

import msgspec

from tactile_toolkit import cards, errors, hub, places, run, store
from tactile_toolkit.cards import yaml_head
from tactile_toolkit.hub.calls import not_cached
from tactile_toolkit.kind import DatasetKind, PublishedSet
from tactile_toolkit.places.opening import repository_place
from tactile_toolkit.places.place import require_kind
from tactile_toolkit.store.folder import PENDING_FOLDER, LocalFolder
from tactile_toolkit.store.job import refuse_unknown_files
from tactile_toolkit.store.manifest import write_manifest
from tactile_toolkit.store.verification import DownloadRecord, HubFile, digest_like, write_download_record
from tactile_toolkit.value_types import JsonDict

# Files that are adapted to the splits of the folder.
_METADATA_FILES = (store.CARD_FILE, store.MANIFEST_FILE)

_EXTRA_FOLDERS = ("reports/", "previews/")
_EXTRA_FILES = ("LICENSE", "LICENSE.md", "LICENSE.txt")
_PICTURE_FOLDER = "images"
_THREADS = 8


@dataclass(frozen=True, slots=True)
class DownloadPlan:
    """Files that a download fetches, keeps and removes.

    Attributes
    ----------
    repository : HubRepository
        Source.
    place : Place
        The splits of the repository and their files.
    folder : DataFolder or None
        Target; None for the Hub's own cache.
    splits : tuple of str
        Splits that the target will have.
    missing : tuple of HubFile
        Files to fetch.
    leftover : list of str
        Files of an earlier download that the repository no longer has; they are removed.
    is_done : bool
        Whether there is nothing to do.
    record : DownloadRecord
        Record of the folder after the download. Its files are all wanted files, except card and manifest,
        which are adapted to the splits of the folder.
    earlier : DownloadRecord or None
        Record of the folder when the plan was made.
    """

    repository: hub.HubRepository
    place: places.Place
    folder: store.DataFolder | None
    splits: tuple[str, ...]
    missing: tuple[HubFile, ...]
    leftover: list[str]
    is_done: bool
    record: DownloadRecord
    earlier: DownloadRecord | None

    @classmethod
    def of(
        cls,
        name: str,
        splits: Sequence[str] = (),
        *,
        revision: str | None = None,
        config: str | None = None,
        kind: DatasetKind | None = None,
        out: str | None = None,
        on_wait: Callable[[str], None] = lambda _: None,
    ) -> DownloadPlan:
        """Plan a download; changes nothing in the target.

        ``name`` is the short name of a published set, or ``USER/NAME``; ``out`` is a folder to fill instead
        of the Hub's cache; ``config`` is a configuration, if the card has several. Data of another ``kind``
        are refused, if their kind is known. Without ``splits`` all are downloaded; splits that the folder has
        already are brought to the same commit. After a transient failure the Hub is asked again; if it does
        not answer, the cache does, but not for a folder.

        Raises InputError (not a repository, no such split, a user's own files in the folder),
        SpecMismatchError (the folder holds another data set) or HubError; then nothing in the folder was
        changed.
        """
        published = DatasetKind.of_published(name)
        if kind is not None and published is not None:
            require_kind(published, kind, name, "tactile download")
        repository = hub.HubRepository.named(name, revision, on_wait)
        if out is not None and repository.is_cache:  # which may list a part of the files only
            raise not_cached(repository.repo_id, "the present list of files")
        place = repository_place(repository, repository.repo_id, config=config).require_config(config)
        if kind is not None and place.is_kind_stated:
            place.require(kind, "tactile download")
        return _plan(repository, place, splits, None if out is None else store.open_folder(out))

    @property
    def published(self) -> PublishedSet | None:
        """The published data set that is downloaded; None for others."""
        return PublishedSet.named(self.repository.repo_id)

    @property
    def missing_bytes(self) -> int:
        """Size of the files to fetch."""
        return sum(file.size_bytes for file in self.missing)

    def run(self, on_progress: Callable[[int, int], None] = lambda _done, _total: None) -> str:
        """Carry out the plan and return the folder with the files: its own, or one of the cache.

        ``on_progress`` gets the number of bytes that have arrived and the total. Raises IntegrityError (a
        file arrived damaged twice; nothing of it is kept, intact files are), HubError (the same call
        continues) or StorageError.
        """
        plan = self
        repository = plan.repository
        folder = plan.folder
        if folder is None:
            repository.fetch(plan.missing, on_bytes=lambda done: on_progress(done, plan.missing_bytes))
            return repository.folder.address()
        if not plan.is_done:
            folder.require_folder()
            with contextlib.ExitStack() as stack:
                try:
                    stack.enter_context(folder.locked(patience_s=0))
                except errors.BusyError as error:
                    repository.on_wait(f"{error.what}; this download begins when it has ended")
                    stack.enter_context(folder.locked(is_patient=True))
                # Another download may have changed the folder.
                if store.read_download_record(folder) != plan.earlier:
                    plan = _plan(repository, plan.place, plan.splits, folder)
                if not plan.is_done:
                    _execute(plan, folder, on_progress)
        return folder.address()


def _plan(
    repository: hub.HubRepository,
    place: places.Place,
    splits: Sequence[str],
    folder: store.DataFolder | None,
) -> DownloadPlan:
    """Compare the files of a repository with those of the target."""
    earlier = None if folder is None else _earlier_record(folder, repository)
    recorded: Mapping[str, HubFile] = earlier.files if earlier is not None else {}
    manifest = repository.manifest
    # Other tools write files of that name, too.
    metadata = tuple(
        path
        for path in _METADATA_FILES
        if path in repository.remote and (path != store.MANIFEST_FILE or manifest)
    )
    all_splits = place.splits
    chosen_names = set(all_splits)
    if splits:
        chosen_names = {split for split in all_splits if not recorded.keys().isdisjoint(place.files[split])}
        chosen_names.update(splits)
    chosen = tuple(split for split in all_splits if split in chosen_names)
    paths = _accompanying_files(repository, chosen, metadata * (folder is None))
    for split in dict.fromkeys([*chosen, *splits]):
        paths += place.paths_of(split)
    names = store.names_inside(dict.fromkeys(paths), f"Hub data set {repository.repo_id!r}")
    files = {path: repository.file(path) for path in names}

    is_intact = partial(_is_intact, folder or repository.folder, earlier)
    here = run.in_threads(is_intact, files.values(), _THREADS)
    missing = tuple(file for file, is_here in zip(files.values(), here, strict=True) if not is_here)
    record = DownloadRecord(
        repository.repo_id, repository.commit, repository.revision, files, all_splits, metadata
    )
    is_done = not missing
    if folder is not None:
        own = [file.path for file in missing if file.path not in recorded and folder.exists(file.path)]
        if own:
            raise errors.InputError(
                f"{folder.address()!r} holds a file of your own where the data set has one ({own[0]!r}); "
                "nothing was changed",
                next="move it away, or choose another folder with --out",
            )
        same = earlier is not None and earlier == msgspec.structs.replace(record, revision=earlier.revision)
        is_done = is_done and same and _is_described(folder, metadata)
    elif missing and repository.is_cache:
        raise not_cached(repository.repo_id, repr(missing[0].path))
    leftover = [path for path in recorded if path not in files]
    return DownloadPlan(repository, place, folder, chosen, missing, leftover, is_done, record, earlier)


def _is_intact(folder: store.DataFolder, earlier: DownloadRecord | None, file: HubFile) -> bool:
    """Return whether a file of a folder is intact; it is read, because a flipped bit changes no time."""
    path = file.path
    digest = file.digest
    if not folder.exists(path) or folder.size_bytes(path) != file.size_bytes:
        return False
    # Stores do not flip bits: a file of a finished download there is known by its size.
    is_known = not folder.is_local and earlier and earlier.finished and earlier.files.get(path) == file
    if is_known or digest is None:
        return True
    with folder.open(path) as stream:
        return digest_like(stream, digest) == digest


def _earlier_record(folder: store.DataFolder, repository: hub.HubRepository) -> DownloadRecord | None:
    """Return the record of an earlier download of the same repository; refuse a folder of anything else."""
    names = folder.names()  # before the record, which another download writes first
    record = store.read_download_record(folder)
    if record is None and store.MANIFEST_FILE not in names:
        if names:
            refuse_unknown_files(folder)
        return None
    if record is None or record.repo_id != repository.repo_id:
        origin = "a data set of another origin"
        if record is not None:
            origin = f"a download of {record.repo_id!r}"
        raise errors.SpecMismatchError(
            f"{folder.address()!r} holds {origin}, not one of {repository.repo_id!r}; nothing in it was "
            "changed",
            next="choose another folder with --out",
        )
    return record


def _accompanying_files(
    repository: hub.HubRepository, splits: Sequence[str], metadata: Iterable[str]
) -> list[str]:
    """Return the paths of files that accompany the shards of some splits: reports, licences, pictures.

    ``metadata`` are card and manifest if they are downloaded unchanged.
    """
    manifest = repository.manifest
    # Rows of data sets of plain pictures refer to files, which are also needed.
    pictures = [f"{_PICTURE_FOLDER}/{split}/" for split in splits if manifest is not None]
    folders = (*_EXTRA_FOLDERS, *pictures)
    listed = {*_EXTRA_FILES}
    if manifest is not None:
        listed.update(manifest.files)
    chosen_paths = (listed - {*_METADATA_FILES, *_shown(manifest)}) | {*metadata}
    return [path for path in repository.files() if path in chosen_paths or path.startswith(folders)]


def _shown(manifest: store.Manifest | None) -> set[str]:
    """Return the files that repeat the shards for the viewer of the Hub."""
    return {path for paths in yaml_head.viewer_files(manifest).values() for path in paths}


def _is_described(folder: store.DataFolder, metadata: Iterable[str]) -> bool:
    """Return whether a folder has its card and a complete manifest."""
    with contextlib.suppress(errors.IntegrityError):
        manifest = store.read_manifest(folder)
        return all(map(folder.exists, metadata)) and (manifest is None or manifest.complete)
    return False


def _execute(plan: DownloadPlan, folder: store.DataFolder, on_progress: Callable[[int, int], None]) -> None:
    """Bring a folder to the commit of the plan; meanwhile readers see that it is not finished."""
    repository = plan.repository
    record = plan.record
    leftover = plan.leftover
    manifest = repository.manifest
    if isinstance(folder, LocalFolder):  # links, which lead out of the folder, are refused first
        for path in (PENDING_FOLDER, store.MANIFEST_FILE, *leftover, *record.files):
            folder.local_path(path)
    folder.remove_temporaries()
    # The record is written first, so that an interrupted download is recognised.
    files = {**record.files}
    if plan.earlier is not None:
        files = {**plan.earlier.files, **files}
    begun = msgspec.structs.replace(record, files=files, finished=False)
    write_download_record(folder, begun)
    if manifest is not None and (plan.missing or leftover):
        write_manifest(folder, replace(manifest, shards=(), complete=False))
    # Before the first new file arrives: old and new files together would look like one data set.
    for path in (*leftover, *(file.path for file in plan.missing)):
        folder.remove(path)
    repository.fetch(plan.missing, folder, lambda done: on_progress(done, plan.missing_bytes))
    _write_metadata(plan, folder, manifest)
    write_download_record(folder, record)


def _write_metadata(plan: DownloadPlan, folder: store.DataFolder, manifest: store.Manifest | None) -> None:
    """Write manifest and card, adapted to the splits of the folder."""
    names = plan.record.metadata_files
    documents = [cached.read_bytes() for cached in plan.repository.local_paths(names)]
    contents = dict(zip(names, documents, strict=True))
    shown = _shown(manifest)
    is_part = set(plan.splits) < set(plan.record.splits)
    is_fitted = is_part or bool(shown)
    if manifest is not None and is_fitted:
        records = [record for record in manifest.shards if record.split in plan.splits]
        files = {path: digest for path, digest in manifest.files.items() if path not in shown}
        contents[store.MANIFEST_FILE] = (
            replace(manifest, shards=tuple(records), files=files).to_json().encode()
        )
    # In this order: the card follows from the manifest.
    if store.MANIFEST_FILE in contents:
        folder.write_bytes(store.MANIFEST_FILE, contents[store.MANIFEST_FILE])
    if store.CARD_FILE in contents:
        card = contents[store.CARD_FILE]
        if is_fitted:
            # An unreadable card stays unchanged.
            with contextlib.suppress(errors.ToolkitError, ValueError, TypeError, RecursionError):
                card = _fitted_card(plan, folder, is_part, card.decode()).encode()
        folder.write_bytes(store.CARD_FILE, card)


def _fitted_card(plan: DownloadPlan, folder: store.DataFolder, is_part: bool, card: str) -> str:
    """Return a card whose YAML head names the files of the folder; a part of a data set gets a note.

    Shards and manifest must be in place.
    """
    # ``datasets.load_dataset(folder)`` fails if the head names a split that is not in the folder.
    files = {split: plan.place.files[split] for split in plan.splits}
    here = yaml_head.card_head(
        cards.FolderSummary.of(folder, source=places.Place(folder.address(), folder, files))
    )
    note = ""
    if is_part:
        note = (
            f"\n> This folder holds {', '.join(f'`{split}`' for split in plan.splits)} of "
            f"`{plan.repository.repo_id}` (commit `{plan.record.commit[:12]}`); the text below describes "
            "the whole data set.\n\n"
        )

    def fit(head: JsonDict) -> None:
        head.update({name: here[name] for name in here if name in head or name == "configs"})

    return yaml_head.with_head(card, fit, note)
