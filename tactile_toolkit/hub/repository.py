"""A data set repository of the Hub at one commit: what it holds, and its files, whole or not handed out."""

from __future__ import annotations

import contextlib
import functools
import json
import os
import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import Any, NoReturn

from tactile_toolkit.errors import HubError, InputError, IntegrityError
from tactile_toolkit.hub.cache import RepositoryCache, is_whole, remove_with_content
from tactile_toolkit.hub.errors import cause_chain, not_cached
from tactile_toolkit.hub.retry import ask, is_passing, is_unanswered
from tactile_toolkit.hub.transfers import ProgressBar, Transfers
from tactile_toolkit.store.manifest import MANIFEST_FILE, Manifest
from tactile_toolkit.store.names import names_inside
from tactile_toolkit.store.origin import Digest, HubFile

__all__ = ["HubName", "HubRepository", "HubSnapshot", "cached_snapshot", "hub_name", "listing", "look_at"]

_PREFIX = "hf://datasets/"
# Names of branches that hold a slash are written %2F, but for the two kinds that the Hub makes itself.
_NAME = re.compile(
    r"(?P<repo>[\w.-]+/[\w.-]+)"
    r"(?:@(?P<revision>refs/convert/[\w.-]+|refs/pr/\d+|[^/@]+))?"
    r"(?:/(?P<path>[^/].*?))?/?"
)
# No longer, where the cache can answer in the Hub's place.
_PROBE_TIMEOUT_S = 5.0
_MAIN = "main"
_SHA256_DIGITS = 64


@dataclass(frozen=True, slots=True)
class HubName:
    """What a name of the Hub means: ``USER/NAME``, a revision if one is named, a path inside or ``""``."""

    repo_id: str
    revision: str | None
    path: str


def hub_name(name: str, revision: str | None = None) -> HubName | None:
    """Read ``USER/NAME[@REVISION]`` or ``hf://datasets/USER/NAME[@REVISION][/PATH]``; None for other names.

    A revision may be given beside the name instead; two different ones are an InputError.
    """
    match = _NAME.fullmatch(name.removeprefix(_PREFIX))
    is_address = name.startswith(_PREFIX)
    if match is None or name.startswith((".", "~")) or (match["path"] and not is_address):
        return None
    named = match["revision"].replace("%2F", "/") if match["revision"] else None
    if named and revision and named != revision:
        message = (
            f"{name!r} names the revision {named!r}, and {revision!r} is given beside it; "
            "next: leave one of them out"
        )
        raise InputError(message)
    return HubName(match["repo"], named or revision, match["path"] or "")


@dataclass(frozen=True, slots=True)
class HubSnapshot:
    """What a commit holds.

    Attributes
    ----------
    repo_id, commit : str
        Repository and full commit.
    files : dict of str to HubFile
        By path. Of a snapshot that was read from the cache, only those in the cache.
    is_cache : bool
        Whether the cache answered because the Hub could not be asked.
    licence : str or None
        What its card says, if it says so.
    is_private : bool
        Whether the Hub says that only its owner sees the repository.
    """

    repo_id: str
    commit: str
    files: Mapping[str, HubFile]
    is_cache: bool = False
    licence: str | None = None
    is_private: bool = False


def look_at(
    repo_id: str,
    revision: str | None = None,
    *,
    patient: bool | None = None,
    on_wait: Callable[[str], None] = lambda _: None,
) -> HubSnapshot:
    """Ask the Hub what a revision holds (``main`` by default); if it is silent, the cache.

    A ``patient`` question waits for a Hub in trouble; by default where nothing of the revision is in the
    cache. Raises HubError when the Hub refused, or cannot be reached and the revision is not in the cache.
    """
    from huggingface_hub import constants

    cache = RepositoryCache(repo_id)
    known = cache.commit_of(revision or _MAIN)
    cached = cached_snapshot(repo_id, known) if known is not None else None
    has_files = cached is not None and bool(cached.files)
    waits = patient or (patient is None and not has_files)
    timeout_s = constants.HF_HUB_ETAG_TIMEOUT if waits else _PROBE_TIMEOUT_S
    try:
        found = ask(
            functools.partial(listing, repo_id, revision, timeout_s),
            repo_id,
            revision,
            waits_s=None if waits else (),
            on_wait=on_wait,
        )
    except HubError as error:
        if cached is not None and has_files and is_unanswered(error):
            return cached
        raise
    cache.remember_commit(revision or _MAIN, found.commit)
    return found


def listing(
    repo_id: str, revision: str | None = None, timeout_s: float | None = None, *, in_pages: bool = False
) -> HubSnapshot:
    """Ask the Hub for all files of a revision; failures are the client's.

    One answer lists some 50,000 files reliably, and quickly; ``in_pages`` lists any number.
    """
    from huggingface_hub import HfApi
    from huggingface_hub.hf_api import RepoFile

    api: Any = HfApi()
    answer = api.dataset_info(repo_id, revision=revision, files_metadata=not in_pages, timeout=timeout_s)
    entries = answer.siblings or ()
    if in_pages:
        tree = api.list_repo_tree(repo_id, recursive=True, revision=answer.sha, repo_type="dataset")
        entries = [entry for entry in tree if isinstance(entry, RepoFile)]
    files = {}
    for entry in entries:
        # Files that git keeps itself are named by git's own digest.
        digest = Digest("sha256", entry.lfs.sha256) if entry.lfs else Digest("git-sha1", entry.blob_id)
        files[entry.rfilename] = HubFile(entry.rfilename, int(entry.size), digest)
    commit = Digest("git-sha1", answer.sha).value
    licence = getattr(answer.card_data, "license", None)
    licence = licence if isinstance(licence, str) else None
    return HubSnapshot(repo_id, commit, files, licence=licence, is_private=bool(answer.private))


def cached_snapshot(repo_id: str, commit: str) -> HubSnapshot:
    """Return what the cache has of a commit."""
    files = {}
    for path, file in RepositoryCache(repo_id).files(commit).items():
        # The name of a blob tells what it holds; a cache without links has none.
        name = Path(os.path.realpath(file)).name
        digest = None
        if file.is_symlink():
            with contextlib.suppress(ValueError):
                digest = Digest("sha256" if len(name) == _SHA256_DIGITS else "git-sha1", name)
        files[path] = HubFile(path, file.stat().st_size, digest)
    return HubSnapshot(repo_id, commit, files, is_cache=True)


@dataclass(frozen=True)
class HubRepository:
    """A data set repository of the Hub, at one commit.

    Parameters
    ----------
    repo_id : str
        ``USER/NAME``.
    revision : str or None
        Branch, tag or commit. What it names is looked up on first use and stays so for this object, so that
        all files are of one commit.
    patient : bool or None
        Whether to wait for a Hub in trouble; by default where the cache could not answer in its place.
    known : HubSnapshot or None
        What it holds, where that was looked up already.
    on_wait : callable
        Told, in a sentence, why there is a wait.

    Notes
    -----
    ``HF_HOME``, ``HF_ENDPOINT``, ``HF_HUB_OFFLINE`` and the stored token are honoured. Files lie in the Hub's
    own cache, so that other programs find them there.
    """

    repo_id: str
    revision: str | None = None
    patient: bool | None = None
    known: HubSnapshot | None = field(default=None, repr=False, compare=False)
    on_wait: Callable[[str], None] = field(default=lambda _: None, repr=False, compare=False)

    @cached_property
    def snapshot(self) -> HubSnapshot:
        """What the repository holds; from the cache when the Hub cannot be reached, see :func:`look_at`."""
        return self.known or look_at(self.repo_id, self.revision, patient=self.patient, on_wait=self.on_wait)

    @cached_property
    def manifest(self) -> Manifest | None:
        """The manifest of a data set made by the toolkit; None of any other, or IntegrityError."""
        if MANIFEST_FILE not in self.snapshot.files:
            return None
        text = Path(self._fetch(MANIFEST_FILE)).read_text(encoding="utf-8", errors="replace")
        try:
            values = json.loads(text)
        except ValueError:
            return None
        # Other tools write files of that name too.
        is_ours = isinstance(values, dict) and {"schema_version", "shards"} <= values.keys()
        return Manifest.from_json(text, f"{self.repo_id}/{MANIFEST_FILE}") if is_ours else None

    @cached_property
    def _shards(self) -> dict[str, HubFile]:
        """The shards that the manifest lists, by path."""
        records = self.manifest.shards if self.manifest is not None else ()
        files = [HubFile(r.shard.data_path, r.bytes, Digest("sha256", r.sha256)) for r in records]
        return {file.path: file for file in files}

    def files(self) -> list[str]:
        """List the paths of all files; without the Hub, those in the cache and in a cached manifest."""
        return sorted({*self.snapshot.files, *(self._shards if self.snapshot.is_cache else ())})

    @contextlib.contextmanager
    def missing_as_not_cached(self, what: str) -> Iterator[None]:
        """Say of what is missing that it is not cached, when the Hub could not be asked."""
        try:
            yield
        except (InputError, IntegrityError) as error:
            if not self.snapshot.is_cache or self.manifest is not None:
                raise
            raise not_cached(self.repo_id, what) from error

    def file(self, path: str) -> HubFile:
        """Return what a file must be: what the manifest says, or else the Hub, as far as either is known.

        Raises IntegrityError where the two disagree (fetching it would not help) and for a name that is not
        that of a file in a folder, HubError for no such file.
        """
        names_inside((path,), f"Hub data set {self.repo_id!r}")
        on_hub = self.snapshot.files.get(path)
        if path == MANIFEST_FILE or self.manifest is None:
            return on_hub or self._lacks(path)
        there = on_hub or self._shards.get(path) or self._lacks(path)
        sha256 = (self.manifest.files or {}).get(path)
        listed = replace(there, digest=Digest("sha256", sha256)) if sha256 else self._shards.get(path, there)
        kinds = {each.digest and each.digest.kind for each in (there, listed)}
        if len(kinds) == 1 and there.digest != listed.digest:
            message = (
                f"{path!r} of Hub data set {self.repo_id!r} is not the file that its {MANIFEST_FILE} lists: "
                f"{there.digest}, expected {listed.digest}; nothing was fetched; next: ask its owner to "
                "upload it again"
            )
            raise IntegrityError(message)
        return listed

    def _lacks(self, path: str) -> NoReturn:
        if self.snapshot.is_cache:
            raise not_cached(self.repo_id, repr(path))
        message = f"Hub data set {self.repo_id!r} has no file {path!r}; next: see what it has on its page"
        raise HubError(message)

    def address(self, path: str) -> str:
        """Return the fsspec address of a file at the commit, for reading it without downloading it whole."""
        # The commit, not what it is called: a branch may move on while its files are read in turn.
        return f"{_PREFIX}{self.repo_id}@{self.snapshot.commit}/{path}"

    def cached(self, path: str, *, anew: bool = False) -> Path | None:
        """Return a file that is in the Hub's cache, whole; None otherwise. Asks nobody, fetches nothing.

        One that was found whole is read again only where it has changed since, or if ``anew``.
        """
        digest = self.file(path).digest
        file = self._place(path)
        is_here = file.is_file() and (digest is None or is_whole(file, digest, anew=anew))
        return file if is_here else None

    def _place(self, path: str) -> Path:
        return RepositoryCache(self.repo_id).snapshot_folder(self.snapshot.commit) / path

    def fetch(self, paths: Sequence[str], transfers: Transfers | None = None) -> list[str]:
        """Bring files into the Hub's cache, or find them there, and return their local paths.

        Each has the checksum of the manifest, where there is one, and else that of the Hub; it is read for
        that once, and again only after it has changed. Raises IntegrityError for one that arrived damaged
        twice or is not what the manifest says (nothing of it is kept), HubError, StorageError.
        """
        names_inside(paths, f"Hub data set {self.repo_id!r}")
        for path in paths:
            self.file(path)  # what cannot be had is told before anything is fetched
        together = transfers or Transfers(on_wait=self.on_wait)
        return together.each(lambda path: self._fetch(path, together), paths)

    def _fetch(self, path: str, transfers: Transfers | None = None) -> str:
        whole = self.cached(path)
        if whole is None:
            remove_with_content(self._place(path))
            whole = self.download(path, transfers or Transfers(on_wait=self.on_wait))
        return str(whole)

    def download(self, path: str, transfers: Transfers, folder: Path | None = None) -> Path:
        """Fetch a file into the Hub's cache, or into a folder, and check it; one damaged is fetched again."""
        from huggingface_hub import hf_hub_download

        wanted = self.file(path)
        digest = wanted.digest
        if self.snapshot.is_cache or digest is None:
            raise not_cached(self.repo_id, repr(path))

        def fetched(bar: Any, *, anew: bool) -> Path:
            try:
                file = hf_hub_download(
                    self.repo_id,
                    path,
                    repo_type="dataset",
                    revision=self.snapshot.commit,
                    local_dir=folder,
                    force_download=anew,
                    tqdm_class=bar,
                )
                with Path(file).open("rb") as stream:
                    os.fsync(stream.fileno())  # before it counts as whole: a power cut must not empty it
            except BaseException:
                bar.take_back()
                raise
            return Path(file)

        for anew in (False, True):
            bar = ProgressBar(transfers, path, wanted.size_bytes)
            file = ask(
                functools.partial(fetched, bar, anew=anew),
                self.repo_id,
                self.revision,
                f"fetching {path!r} of",
                is_question=False,
                may_repeat=_may_repeat_download,
                on_wait=transfers.say,
            )
            if is_whole(file, digest):
                return file
            found = "nothing"
            with contextlib.suppress(FileNotFoundError):  # removed by another process that found the same
                found = str(digest.of(file))
            remove_with_content(file)
            bar.take_back()
        message = (
            f"{path!r} of Hub data set {self.repo_id!r} arrived damaged twice: {found}, expected {digest}; "
            "nothing of it was kept; next: try again later or through another network"
        )
        raise IntegrityError(message)


def _may_repeat_download(error: Exception) -> bool:
    """Tell a failure of a download that may pass; what the client itself waited for in vain is not one."""
    from huggingface_hub import errors

    chain = cause_chain(error)
    if any(isinstance(link, errors.LocalEntryNotFoundError) for link in chain):
        return False
    # The client has no type of its own for a file that is shorter than was announced.
    is_cut_short = any(isinstance(link, OSError) and "Consistency check" in str(link) for link in chain)
    return is_cut_short or is_passing(error)
