"""Whether a file is what the Hub, or the manifest of its data set, says it is."""

from __future__ import annotations

import contextlib
import hashlib
import os
from dataclasses import dataclass
from pathlib import Path

from dataset_store.rowgroups import cache_folder

__all__ = ["Digest", "is_whole", "remember_whole"]

_PIECE_BYTES = 1 << 20


@dataclass(frozen=True, slots=True)
class Digest:
    """What proves the content of a file.

    Attributes
    ----------
    kind : str
        ``"sha256"`` for large files and all that a manifest lists, ``"git-sha1"`` for files in git itself.
    value : str
        In hexadecimal.
    """

    kind: str
    value: str

    def __str__(self) -> str:
        return f"{self.kind} {self.value}"

    def of(self, file: Path) -> Digest:
        """Return the digest of the same kind of a local file, read in pieces."""
        found = hashlib.sha256() if self.kind == "sha256" else hashlib.sha1(usedforsecurity=False)
        if self.kind == "git-sha1":
            # Git hashes a head with the size before the content.
            found.update(b"blob %d\0" % file.stat().st_size)
        with file.open("rb") as stream:
            while piece := stream.read(_PIECE_BYTES):
                found.update(piece)
        return Digest(self.kind, found.hexdigest())


def is_whole(file: Path, digest: Digest) -> bool:
    """Tell whether a file has a digest; a file that was found whole is not read again until it changes."""
    if _mark(file, digest).exists():
        return True
    if digest.of(file) != digest:
        return False
    remember_whole(file, digest)
    return True


def remember_whole(file: Path, digest: Digest) -> None:
    """Note that a file has a digest; where notes cannot be kept, it is read again next time."""
    mark = _mark(file, digest)
    with contextlib.suppress(OSError):
        mark.parent.mkdir(parents=True, exist_ok=True)
        mark.touch()


def _mark(file: Path, digest: Digest) -> Path:
    real = Path(os.path.realpath(file))
    facts = real.stat()
    text = repr((str(real), facts.st_size, facts.st_mtime_ns, facts.st_ino, str(digest)))
    return cache_folder() / "checked" / hashlib.sha256(text.encode()).hexdigest()[:40]
