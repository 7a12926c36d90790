"""What of the Hub is on this machine: the cache of the Hub's client, and which files had the right digest."""

from __future__ import annotations

import contextlib
import hashlib
import os
import re
from pathlib import Path

from tactile_toolkit.cache import cache_folder
from tactile_toolkit.store.files import atomic_file
from tactile_toolkit.store.names import problem_of_name
from tactile_toolkit.store.origin import Digest

_COMMIT = re.compile(r"[0-9a-f]{40}")


def matches_digest(file: Path, digest: Digest, *, force: bool = False) -> bool:
    """Return whether a file has a digest; one that had it is not read again until it changes.

    A bit that the disk has flipped does not show: with ``force`` the file is read in any case.
    """
    try:
        # Before the file is read: what takes its place meanwhile was not looked at.
        mark = _mark(file, digest)
        if mark.exists() and not force:
            return True
        is_same = digest.of(file) == digest
    except FileNotFoundError:  # another process has found it damaged, and removed it
        return False
    with contextlib.suppress(OSError):  # where marks cannot be kept, it is read again next time
        if is_same:
            mark.parent.mkdir(parents=True, exist_ok=True)
            # An empty file, whose name is all: nothing to lock, nothing to tear.
            mark.touch()
        else:
            mark.unlink(missing_ok=True)
    return is_same


def _mark(file: Path, digest: Digest) -> Path:
    real = Path(os.path.realpath(file))
    stat = real.stat()
    # The last is when anything of the file was changed last, which programs cannot set.
    seen = (stat.st_size, stat.st_mtime_ns, stat.st_ino, stat.st_ctime_ns)
    text = repr((str(real), *seen, str(digest)))
    return cache_folder() / "checked" / hashlib.sha256(text.encode()).hexdigest()[:40]


def snapshot_folder(repo_id: str, commit: str) -> Path:
    """Return the folder of a commit's files, which are links to their contents where the system has links."""
    return _folder(repo_id) / "snapshots" / commit


def commit_of(repo_id: str, revision: str) -> str | None:
    """Return the commit that a revision named when it was last looked at; None when it never was."""
    found = revision
    if not _COMMIT.fullmatch(revision) and not problem_of_name(revision):
        with contextlib.suppress(OSError, UnicodeDecodeError):
            found = (_folder(repo_id) / "refs" / revision).read_text().strip()
    return found if _COMMIT.fullmatch(found) else None


def remember_commit(repo_id: str, revision: str, commit: str) -> None:
    """Note which commit a revision names; a cache that cannot be written is not an error."""
    if commit_of(repo_id, revision) not in (commit, revision) and not problem_of_name(revision):
        with contextlib.suppress(OSError), atomic_file(_folder(repo_id) / "refs" / revision) as stream:
            stream.write(commit.encode())


def _folder(repo_id: str) -> Path:
    from huggingface_hub import constants

    # The layout of the Hub's own client, so that either finds what the other has fetched.
    return Path(constants.HF_HUB_CACHE) / f"datasets--{repo_id.replace('/', '--')}"
