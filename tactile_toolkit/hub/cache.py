"""What of the Hub is on this machine: the Hub's own cache, and which files were found whole before."""

from __future__ import annotations

import contextlib
import hashlib
import os
import re
from dataclasses import dataclass
from pathlib import Path

from tactile_toolkit.cache import cache_folder
from tactile_toolkit.store.files import atomic_file
from tactile_toolkit.store.names import problem_of_name
from tactile_toolkit.store.origin import Digest

__all__ = ["RepositoryCache", "is_whole", "remove_with_content"]

_COMMIT = re.compile(r"[0-9a-f]{40}")


def is_whole(file: Path, digest: Digest, *, anew: bool = False) -> bool:
    """Tell whether a file has a digest; one that was found whole is not read again until it changes.

    A bit that the disk has flipped is no change that shows: ``anew`` reads the file in any case.
    """
    try:
        # Before the file is read: what takes its place meanwhile is not what was found whole.
        mark = _mark(file, digest)
        if not anew and mark.exists():
            return True
        is_same = digest.of(file) == digest
    except FileNotFoundError:  # another process has found it damaged, and removed it
        return False
    with contextlib.suppress(OSError):  # where notes cannot be kept, it is read again next time
        if is_same:
            mark.parent.mkdir(parents=True, exist_ok=True)
            # The name of an empty file says it all: nothing to lock, nothing to tear.
            mark.touch()
        else:
            mark.unlink(missing_ok=True)
    return is_same


def _mark(file: Path, digest: Digest) -> Path:
    real = Path(os.path.realpath(file))
    facts = real.stat()
    # The last is when anything of the file was changed last, which programs cannot set.
    seen = (facts.st_size, facts.st_mtime_ns, facts.st_ino, facts.st_ctime_ns)
    text = repr((str(real), *seen, str(digest)))
    return cache_folder() / "checked" / hashlib.sha256(text.encode()).hexdigest()[:40]


@dataclass(frozen=True, slots=True)
class RepositoryCache:
    """The part of the Hub's cache that belongs to one data set repository."""

    repo_id: str

    @property
    def folder(self) -> Path:
        """Folder of the repository."""
        from huggingface_hub import constants

        # The layout of the Hub's own client, so that either finds what the other has fetched.
        return Path(constants.HF_HUB_CACHE) / f"datasets--{self.repo_id.replace('/', '--')}"

    def snapshot_folder(self, commit: str) -> Path:
        """Folder of the files of a commit, which are links to their contents where the system has links."""
        return self.folder / "snapshots" / commit

    def commit_of(self, revision: str) -> str | None:
        """Return the commit that a revision named when it was last looked at; None when it never was."""
        if _COMMIT.fullmatch(revision):
            return revision
        found = ""
        if not problem_of_name(revision):
            with contextlib.suppress(OSError, UnicodeDecodeError):
                found = (self.folder / "refs" / revision).read_text().strip()
        return found if _COMMIT.fullmatch(found) else None

    def remember_commit(self, revision: str, commit: str) -> None:
        """Note which commit a revision names; a cache that cannot be written is not an error."""
        if problem_of_name(revision) or _COMMIT.fullmatch(revision) or self.commit_of(revision) == commit:
            return
        with contextlib.suppress(OSError), atomic_file(self.folder / "refs" / revision) as stream:
            stream.write(commit.encode())

    def files(self, commit: str) -> dict[str, Path]:
        """Return the cached files of a commit by their path in the repository."""
        root = self.snapshot_folder(commit)
        found = sorted(file for file in root.rglob("*") if file.is_file())
        return {file.relative_to(root).as_posix(): file for file in found}

    def size_bytes(self) -> int:
        """Return the size of all whole contents."""
        blobs = self.folder / "blobs"
        files = [file for file in blobs.iterdir() if file.is_file()] if blobs.is_dir() else []
        # Contents, as each file of a commit is a link to one of them, and commits share them.
        return sum(file.stat().st_size for file in files if file.suffix != ".incomplete")


def remove_with_content(file: Path) -> None:
    """Remove a file, and where it is a link all that it leads to: damaged content must not be found again."""
    while file.is_symlink():
        target = file.parent / file.readlink()
        file.unlink(missing_ok=True)
        file = target
    file.unlink(missing_ok=True)
