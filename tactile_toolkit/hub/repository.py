"""A data set repository of the Hub at one commit: its listing, and its files, checked before use.

Files are kept in the cache of the Hub's own client, which other programs share.
"""

from __future__ import annotations

import contextlib
import os
import re
import threading
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property, partial
from multiprocessing.pool import ThreadPool
from pathlib import Path
from typing import Any

import huggingface_hub

from tactile_toolkit import errors, store, wording
from tactile_toolkit.hub.calls import (
    TooLargeError,
    call_with_retry,
    counting_options,
    has_answered,
    not_cached,
    require_addresses,
)
from tactile_toolkit.kind import DatasetKind, PublishedSet
from tactile_toolkit.store.files import scratch_folder, sync_file, write_file
from tactile_toolkit.store.folder import LocalFolder
from tactile_toolkit.store.manifest import is_of_others
from tactile_toolkit.store.remote import FsspecFolder
from tactile_toolkit.store.verification import DIGEST, HubFile, has_digest

_PREFIX = "hf://datasets/"
# A slash in the name of a branch is written %2F, except in the two kinds of branches that the Hub makes
# itself.
_NAME = re.compile(
    r"(?P<repo>[\w.-]+/[\w.-]+)"
    r"(?:@(?P<revision>refs/convert/[\w.-]+|refs/pr/\d+|[^/@]+))?"
    r"(?:/(?P<path>[^/].*?))?/?"
)
_COMMIT = re.compile(r"[0-9a-f]{40}")
_MAIN = "main"
_LONGEST_SHOWN = 200
_FILES_AT_ONCE = 8  # as in the Hub's own client


@dataclass(frozen=True, slots=True)
class HubName:
    """A name of the Hub: ``USER/NAME``, the revision if one is named, and the path inside or ``""``."""

    repo_id: str
    revision: str | None
    path: str


def hub_name(name: str, revision: str | None = None) -> HubName | None:
    """Read ``USER/NAME[@REVISION]`` or ``hf://datasets/USER/NAME[@REVISION][/PATH]``; None for other names.

    A revision may be given next to the name instead. Two different ones are an InputError, and so is an
    address that may hold a key.
    """
    errors.require_public(name)
    match = _NAME.fullmatch(name.removeprefix(_PREFIX))
    is_address = name.startswith(_PREFIX)
    if match is None or name.startswith((".", "~")) or (match["path"] and not is_address):
        return None
    named = (match["revision"] or "").replace("%2F", "/")
    if named and revision and named != revision:
        raise errors.InputError(
            f"{name!r} names the revision {named!r}, and {revision!r} is given next to it",
            next="leave one of them out",
        )
    return HubName(match["repo"], named or revision, match["path"] or "")


def named_on_hub(name: str, revision: str | None) -> HubName:
    """Resolve a name or short name to a repository, or a path in one; InputError for other names."""
    known = PublishedSet.named(name)
    repo_id = known.repo_id if known is not None else name
    named = hub_name(repo_id, revision)
    if named is None:
        near = [entry.name for kind in DatasetKind.installed() for entry in kind.published]
        with contextlib.suppress(OSError, errors.InputError):  # an unknown user's home
            path = store.local_path(name)
            near += map(str, path.parent.iterdir() if path else ())
        raise errors.InputError(
            f"{wording.shortened(name, _LONGEST_SHOWN)!r} does not exist; expected a folder, a Parquet file, "
            f"a repository of the Hub (USER/NAME) or a published set{wording.did_you_mean(name, near)}",
            next="check the name (`tactile list` lists the published sets), or make a data set",
        )
    return named


def commit_of(repo_id: str, revision: str) -> str | None:
    """Return the commit that a revision named when it was last resolved; None if it never was."""
    commit = revision
    if not _COMMIT.fullmatch(revision) and not store.problem_of_name(revision):
        with contextlib.suppress(OSError, UnicodeDecodeError):
            commit = (_cache_of(repo_id) / "refs" / revision).read_text().strip()
    if _COMMIT.fullmatch(commit):
        return commit
    return None


def remember_commit(repo_id: str, revision: str, commit: str) -> None:
    """Record the commit of a revision; a cache that cannot be written is not an error."""
    if commit_of(repo_id, revision) not in (commit, revision) and not store.problem_of_name(revision):
        with contextlib.suppress(OSError):
            refs = _cache_of(repo_id) / "refs"
            write_file(refs / revision, lambda stream: stream.write(commit.encode()))


def _cache_of(repo_id: str) -> Path:
    require_addresses()  # which the client reads when it is imported
    from huggingface_hub import constants

    return Path(constants.HF_HUB_CACHE) / f"datasets--{repo_id.replace('/', '--')}"


class _StoppedError(Exception):
    """Another file failed, or the user has interrupted the download."""


@dataclass(frozen=True)
class HubRepository:
    """A data set repository of the Hub, at one commit.

    Attributes
    ----------
    repo_id : str
        ``USER/NAME``.
    revision : str or None
        Requested branch, tag or commit.
    commit : str
        Commit that the revision named when it was opened, 40 digits; all files are of this commit.
    remote : dict of str to HubFile
        Files by path; only those in the cache, if the cache answered.
    is_cache : bool
        Whether the cache answered because the Hub could not be reached.
    licence : str or None
        Licence that its card states.
    is_private : bool
        Whether the Hub says that only its owner sees the repository.
    on_wait : callable
        Gets a sentence for each wait.

    Notes
    -----
    ``HF_HOME``, ``HF_ENDPOINT``, ``HF_HUB_OFFLINE`` and the stored token are honoured.
    """

    repo_id: str
    revision: str | None
    commit: str
    remote: Mapping[str, HubFile] = field(repr=False)
    is_cache: bool = False
    licence: str | None = None
    is_private: bool = False
    on_wait: Callable[[str], None] = field(default=lambda _: None, repr=False, compare=False)

    @classmethod
    def named(
        cls, name: str, revision: str | None = None, on_wait: Callable[[str], None] = lambda _: None
    ) -> HubRepository:
        """Look up a repository by its name, or the short name of a published set.

        Asks again after transient failures. Raises InputError for other names, and for a part of a
        repository; HubError as the Hub answers.
        """
        resolved = named_on_hub(name, revision)
        if resolved.path:
            raise errors.InputError(
                f"{name!r} is a part of a repository; expected all of it",
                next=f"leave {resolved.path!r} out",
            )
        return open_repository(resolved.repo_id, resolved.revision, patient=True, on_wait=on_wait)

    @property
    def folder(self) -> store.DataFolder:
        """Folder of the commit in the cache, with links to contents if the system has links."""
        return store.open_folder(str(_cache_of(self.repo_id) / "snapshots" / self.commit))

    @cached_property
    def manifest(self) -> store.Manifest | None:
        """Manifest of a data set made by the toolkit; None for other data sets, IntegrityError if damaged."""
        if store.MANIFEST_FILE not in self.remote:
            return None
        content = self.local_paths((store.MANIFEST_FILE,))[0].read_bytes()
        if is_of_others(content):
            return None
        return store.Manifest.from_json(content, f"{self.repo_id}/{store.MANIFEST_FILE}")

    @cached_property
    def _listed(self) -> dict[str, HubFile]:
        """Shards and further files of the commit as the manifest states them, by path."""
        if self.manifest is None:
            return {}
        digests = {path: digest for path, digest in self.manifest.files.items() if path in self.remote}
        shards = {
            record.file: HubFile(record.file, record.bytes, record.sha256) for record in self.manifest.shards
        }
        return shards | {path: HubFile(path, self.remote[path].size_bytes, digests[path]) for path in digests}

    @property
    def size_bytes(self) -> int:
        """Size of all known files."""
        return sum(file.size_bytes for file in self.remote.values())

    def files(self) -> list[str]:
        """List the paths of all files; if the cache answered, those in the cache and in its manifest."""
        if self.is_cache:
            return sorted({*self.remote, *self._listed})
        return sorted(self.remote)

    def file(self, path: str) -> HubFile:
        """Return the expected size and digest of a file, as the manifest states them, or else the Hub.

        Raises IntegrityError if the two disagree (fetching would not help) or the name cannot be that of a
        file in a folder, HubError if there is no such file.
        """
        store.names_inside((path,), f"Hub data set {self.repo_id!r}")
        remote = self.remote.get(path)
        expected = remote if path == store.MANIFEST_FILE else self._listed.get(path, remote)
        if expected is None and self.is_cache:
            raise not_cached(self.repo_id, repr(path))
        if expected is None:
            raise errors.HubError(
                f"Hub data set {self.repo_id!r} has no file {path!r}", next="see what it has on its page"
            )
        digests = [known.digest for known in (remote, expected) if known and known.digest]
        if len(set(digests)) == len(set(map(len, digests))):  # one of each kind
            return expected
        raise errors.IntegrityError(
            f"{path!r} of Hub data set {self.repo_id!r} is not the file that its "
            f"{store.MANIFEST_FILE} lists: {digests[0]}, expected {digests[1]}; nothing was fetched",
            next="ask its owner to upload it again",
        )

    def address(self, path: str) -> str:
        """Return the fsspec address of a file at the commit, to read it piece by piece."""
        # The commit, not the branch, which may move on while its files are read.
        return f"{_PREFIX}{self.repo_id}@{self.commit}/{path}"

    def local_paths(self, paths: Sequence[str]) -> list[Path]:
        """Return the paths of files in the Hub's cache; those that are missing by their sizes are fetched.

        Raises as :meth:`fetch`.
        """
        # A file that does not exist is reported before anything is fetched.
        files = [self.file(path) for path in paths]
        here = self.folder
        self.fetch([file for file in files if (here.info(file.path) or {}).get("size") != file.size_bytes])
        return [Path(here.address(path)) for path in paths]

    def fetch(
        self,
        files: Sequence[HubFile],
        folder: store.DataFolder | None = None,
        on_bytes: Callable[[int], None] = lambda _: None,
    ) -> None:
        """Fetch files, several at once, into the Hub's cache or a folder; the first failure ends all.

        Each file is compared with the digest of the manifest, or else that of the Hub. ``on_bytes`` gets the
        total number of bytes that have arrived, from one thread at a time. Other threads may still be at work
        when this returns, and only this one changes a local folder. Raises IntegrityError for a file
        that arrived damaged twice (nothing of it is kept), HubError, StorageError.
        """
        lock = threading.Lock()
        stopped = threading.Event()
        arrived = dict[str, int]()
        total = 0

        def count(file: HubFile, size_bytes: int) -> None:
            nonlocal total
            if size_bytes > file.size_bytes:
                raise TooLargeError(f"more than the {file.size_bytes:,} bytes that were expected")
            with lock:
                if stopped.is_set():
                    raise _StoppedError
                total += size_bytes - arrived.get(file.path, 0)
                arrived[file.path] = size_bytes
                on_bytes(total)

        def fetch_one(file: HubFile) -> str | BaseException:
            try:
                local_path = self._fetch_checked(file, stage, partial(count, file))
                if isinstance(folder, FsspecFolder):
                    folder.upload(file.path, local_path)
                    local_path.unlink()
            except BaseException as error:  # the pool would lose a SystemExit, and wait for the file forever
                return error
            return file.path

        with contextlib.ExitStack() as stack:
            stage = None
            inside = ""
            if isinstance(folder, LocalFolder):
                inside = stack.enter_context(folder.stage())
                stage = folder.local_path(inside)
            elif folder is not None:
                stage = stack.enter_context(scratch_folder())
            stack.callback(stopped.set)
            # Daemon threads; at exit, the interpreter waits for those of an executor.
            with ThreadPool(max(1, min(_FILES_AT_ONCE, len(files)))) as pool:
                for result in pool.imap_unordered(fetch_one, files):
                    if isinstance(result, BaseException):
                        raise result
                    if isinstance(folder, LocalFolder):
                        folder.move(f"{inside}/{result}", result)

    def _fetch_checked(self, file: HubFile, folder: Path | None, count: Callable[[int], None]) -> Path:
        """Fetch a file into the Hub's cache or a folder, and check it; a damaged file is fetched again."""
        path = file.path
        digest = file.digest
        if self.is_cache or digest is None:
            raise not_cached(self.repo_id, repr(path))
        options = {"repo_type": "dataset", "revision": self.commit, "local_dir": folder}
        options |= counting_options(count)
        cached = Path(self.folder.address(path))
        if folder is None:
            self._wait_for_another(path)
        # An intact file may have been fetched by another process meanwhile.
        for force in (folder is None and cached.exists() and not has_digest(cached, digest), True):
            fetch = partial(
                huggingface_hub.hf_hub_download, self.repo_id, path, force_download=force, **options
            )
            doing = f"fetching {path!r} of"
            local_path = Path(call_with_retry(fetch, self.repo_id, doing, on_wait=self.on_wait))
            if has_digest(local_path, digest):
                sync_file(local_path)  # a power cut must not empty a file that counts as intact
                count(file.size_bytes)
                return local_path
            # Also the target of its link in the cache: damaged content must not be found again.
            content = Path(os.path.realpath(local_path))
            if content.is_relative_to(os.path.realpath(_cache_of(self.repo_id))):
                content.unlink(missing_ok=True)
            local_path.unlink(missing_ok=True)
        raise errors.IntegrityError(
            f"{path!r} of Hub data set {self.repo_id!r} arrived damaged twice, expected {digest}; "
            "nothing of it was kept",
            next="try again later or through another network",
        )

    def _wait_for_another(self, path: str) -> None:
        """Wait for a process that fetches a file into the cache; BusyError if that process was stopped."""
        # The client would wait on the same lock for ever, without a word.
        cache = _cache_of(self.repo_id)
        lock = cache.parent / ".locks" / cache.name / f"{self.remote[path].digest}.lock"
        with contextlib.suppress(OSError):
            lock.parent.mkdir(parents=True, exist_ok=True)
            with store.locked(lock, is_patient=True):
                pass


def open_repository(
    repo_id: str,
    revision: str | None = None,
    *,
    patient: bool = False,
    on_wait: Callable[[str], None] = lambda _: None,
) -> HubRepository:
    """Look up the files of a revision, ``main`` by default, on the Hub, or in the cache without an answer.

    After a transient failure the Hub is asked again if the cache has nothing, or with ``patient``. Raises
    HubError if the Hub refused, or cannot be reached and the revision is not in the cache.
    """
    cached = find_cached(repo_id, revision)
    waits_s = None if patient or cached is None else ()
    ask = partial(listing, repo_id, revision)
    try:
        repository = call_with_retry(ask, repo_id, waits_s=waits_s, on_wait=on_wait)
    except errors.HubError as error:
        if cached is None or has_answered(error):
            raise
        repository = cached
    remember_commit(repo_id, revision or _MAIN, repository.commit)
    return replace(repository, on_wait=on_wait)


def listing(repo_id: str, revision: str | None = None) -> HubRepository:
    """Ask the Hub for all files of a revision; raises exceptions of its client."""
    # The client does not load this module on first use.
    from huggingface_hub import constants

    timeout_s = constants.HF_HUB_ETAG_TIMEOUT
    answer: Any = huggingface_hub.HfApi().dataset_info(
        repo_id, revision=revision, files_metadata=True, timeout=timeout_s
    )
    files = {}
    for entry in answer.siblings or ():
        # Files that are stored in git have git's own digest.
        digest = entry.lfs.sha256 if entry.lfs else str(entry.blob_id)
        files[entry.rfilename] = HubFile(entry.rfilename, int(entry.size), digest)
    if not _COMMIT.fullmatch(answer.sha):
        raise ValueError(f"{answer.sha[:80]!r} is not a commit")
    licence = getattr(answer.card_data, "license", None)
    licence = licence if isinstance(licence, str) else None
    is_private = bool(answer.private)
    return HubRepository(repo_id, revision, answer.sha, files, licence=licence, is_private=is_private)


def find_cached(repo_id: str, revision: str | None = None) -> HubRepository | None:
    """Return the cached files of the commit that a revision named last; None if there are none."""
    commit = commit_of(repo_id, revision or _MAIN)
    files = {}
    if commit is None:
        return None
    repository = HubRepository(repo_id, revision, commit, {}, is_cache=True)
    root = Path(repository.folder.root)
    for file in sorted(file for file in root.rglob("*") if file.is_file()):
        # The name of a blob is the digest of its content; a cache without links has no blobs.
        path = file.relative_to(root).as_posix()
        blob = Path(os.path.realpath(file)).name
        is_named = file.is_symlink() and DIGEST.fullmatch(blob)
        files[path] = HubFile(path, file.stat().st_size, blob if is_named else None)
    if files:
        return replace(repository, remote=files)
    return None
