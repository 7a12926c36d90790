"""What proves the content of a file, and what the Hub says of its files."""

from __future__ import annotations

import hashlib
from dataclasses import dataclass
from pathlib import Path

__all__ = ["Digest", "HubFile"]

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


@dataclass(frozen=True, slots=True)
class HubFile:
    """A file of a repository.

    Attributes
    ----------
    path : str
        Its place.
    size_bytes : int
        Its size.
    digest : Digest or None
        What the Hub says it is; None where only a cached copy is known that does not tell.
    """

    path: str
    size_bytes: int
    digest: Digest | None
