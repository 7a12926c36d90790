"""One commit of a repository of the Hub: what it holds, as the Hub or the cache says."""

from __future__ import annotations

import contextlib
import os
import re
import uuid
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from tactile_toolkit.errors import HubError, ToolkitError
from tactile_toolkit.hub.errors import failure_of, shown_cause
from tactile_toolkit.hub.retry import ask, could_not_ask, is_passing
from tactile_toolkit.store.folder import atomic_file
from tactile_toolkit.store.origin import Digest, HubFile

__all__ = ["HubSnapshot", "RepositoryCache", "look_at"]

_COMMIT = re.compile(r"[0-9a-f]{40}")


@dataclass(frozen=True, slots=True)
class RepositoryCache:
    """The part of the Hub's cache that belongs to one data set repository."""

    repo_id: str

    @property
    def folder(self) -> Path:
        """Folder of the repository."""
        from huggingface_hub import constants

        return Path(constants.HF_HUB_CACHE) / f"datasets--{self.repo_id.replace('/', '--')}"

    def blob(self, digest: Digest) -> Path:
        """Place of a content."""
        return self.folder / "blobs" / digest.value

    def stage(self, digest: Digest) -> Path:
        """Place where a content collects while it arrives."""
        return self.folder / "blobs" / f"{digest.value}.incomplete"

    def commit_of(self, revision: str) -> str | None:
        """Return the commit that a revision named when it was last looked at; None when it never was."""
        if _COMMIT.fullmatch(revision):
            return revision
        with contextlib.suppress(OSError):
            return (self.folder / "refs" / revision).read_text().strip()
        return None

    def remember_commit(self, revision: str, commit: str) -> None:
        """Note which commit a revision names; a cache that cannot be written is no error."""
        if _COMMIT.fullmatch(revision) or self.commit_of(revision) == commit:
            return
        with contextlib.suppress(OSError), atomic_file(self.folder / "refs" / revision) as stream:
            stream.write(commit.encode())

    def files(self, commit: str) -> dict[str, Path]:
        """Return the cached files of a commit by their path in the repository."""
        root = self.folder / "snapshots" / commit
        found = sorted(file for file in root.rglob("*") if file.is_file())
        return {file.relative_to(root).as_posix(): file for file in found}

    def file(self, commit: str, path: str) -> Path | None:
        """Return a cached file; None when it is not there."""
        place = self.folder / "snapshots" / commit / path
        return place if place.is_file() else None

    def link(self, commit: str, path: str, blob: Path) -> Path:
        """Give a content its name in a commit; where links are not known, the content itself is moved there.

        Raises
        ------
        OSError
            As the file system raises it.
        """
        from huggingface_hub import constants

        place = self.folder / "snapshots" / commit / path
        place.parent.mkdir(parents=True, exist_ok=True)
        fresh = place.with_name(f"{place.name}.{uuid.uuid4().hex[:8]}.incomplete")
        if not getattr(constants, "HF_HUB_DISABLE_SYMLINKS", False):
            with contextlib.suppress(OSError, NotImplementedError):
                fresh.symlink_to(os.path.relpath(blob, place.parent))
                return fresh.replace(place)
        return blob.replace(place)

    def size_bytes(self) -> int:
        """Return the size of all whole contents."""
        blobs = self.folder / "blobs"
        files = [file for file in blobs.iterdir() if file.is_file()] if blobs.is_dir() else []
        return sum(file.stat().st_size for file in files if file.suffix != ".incomplete")

    def remove(self, commit: str, path: str) -> None:
        """Remove a cached file and its content."""
        place = self.folder / "snapshots" / commit / path
        Path(os.path.realpath(place)).unlink(missing_ok=True)
        place.unlink(missing_ok=True)


_PROBE_TIMEOUT_S = 5.0
_MAIN = "main"
_DIGEST_OF_LENGTH = {64: "sha256", 40: "git-sha1"}


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
    may_pass : bool
        Whether that is a trouble of the kind that passes: the Hub is overloaded, a connection broke.
    licence : str or None
        What its card says, if it says so.
    """

    repo_id: str
    commit: str
    files: Mapping[str, HubFile]
    is_cache: bool = False
    licence: str | None = None
    may_pass: bool = False


def look_at(
    repo_id: str,
    revision: str | None = None,
    *,
    patient: bool = True,
    insists: bool = False,
    on_wait: Callable[[str], None] = lambda _: None,
) -> HubSnapshot:
    """Ask the Hub, once and quickly, what a revision holds; without an answer, ask the cache.

    Parameters
    ----------
    repo_id, revision : str
        Repository and what to look at; default ``main``.
    patient : bool
        Wait for a Hub in trouble when nothing of the revision is in the cache.
    insists : bool
        Wait for it even so: something is wanted that the cache does not have.
    on_wait : callable
        Told, in a sentence, why there is a wait.

    Raises
    ------
    HubError
        The Hub refused; or it cannot be reached and the revision is not in the cache.
    InputError
        ``repo_id`` is no name of a repository.
    """
    cache = RepositoryCache(repo_id)
    known = cache.commit_of(revision or _MAIN)
    cached = known if known and cache.files(known) else None
    try:
        if not patient or (cached and not insists):
            info = _info(repo_id, revision, _PROBE_TIMEOUT_S)
        else:
            info = ask(lambda: _info(repo_id, revision), repo_id, revision, on_wait=on_wait)
    except Exception as error:
        failure = error if isinstance(error, ToolkitError) else failure_of(error, repo_id, revision)
        if cached and isinstance(failure, HubError) and could_not_ask(error):
            return _from_cache(cache, cached, may_pass=is_passing(error))
        if failure is None or failure is error:
            raise
        raise failure from shown_cause(error)
    snapshot = _from_info(repo_id, info)
    cache.remember_commit(revision or _MAIN, snapshot.commit)
    return snapshot


def _info(repo_id: str, revision: str | None, timeout_s: float | None = None) -> Any:
    from huggingface_hub import HfApi, constants

    timeout_s = timeout_s or constants.HF_HUB_ETAG_TIMEOUT
    return HfApi().dataset_info(repo_id, revision=revision, files_metadata=True, timeout=timeout_s)


def _from_info(repo_id: str, info: Any) -> HubSnapshot:
    files = {}
    for entry in info.siblings or ():
        large = entry.lfs
        digest = Digest("sha256", large.sha256) if large else Digest("git-sha1", entry.blob_id)
        files[entry.rfilename] = HubFile(entry.rfilename, int(entry.size), digest)
    licence = getattr(info.card_data, "license", None)
    return HubSnapshot(repo_id, info.sha, files, licence=licence if isinstance(licence, str) else None)


def _from_cache(cache: RepositoryCache, commit: str, *, may_pass: bool) -> HubSnapshot:
    files = {}
    for path, place in cache.files(commit).items():
        # The name of a blob tells what it holds; a cache without links has none.
        name = Path(os.path.realpath(place)).name
        kind = _DIGEST_OF_LENGTH.get(len(name)) if place.is_symlink() else None
        digest = Digest(kind, name) if kind else None
        files[path] = HubFile(path, place.stat().st_size, digest)
    return HubSnapshot(cache.repo_id, commit, files, is_cache=True, may_pass=may_pass)
