"""Where huggingface_hub keeps what it has fetched: the layout that its documentation describes.

::

    $HF_HOME/hub/datasets--USER--NAME/
        refs/main                       commit that a branch or tag named when it was last looked at
        blobs/<etag>                    contents; the etag is the SHA-256, or git's name of a small file
        snapshots/<commit>/data/...     links to the blobs
"""

from __future__ import annotations

import contextlib
import os
import re
import uuid
from dataclasses import dataclass
from pathlib import Path

from dataset_store.hub.checks import Digest
from dataset_store.storage import atomic_file

__all__ = ["RepositoryCache"]

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
