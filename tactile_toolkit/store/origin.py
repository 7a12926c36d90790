"""What a folder says about the download that fills it: from where, which commit, which files.

The Hub names the content of a file by a digest of one of two kinds, which is all that a folder without a
manifest can be checked by.
"""

from __future__ import annotations

import hashlib
import json
import re
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import IO

import msgspec

from tactile_toolkit.store.files import open_regular
from tactile_toolkit.store.folder import DataFolder
from tactile_toolkit.store.names import Count, damaged, decode, names_inside

RECORD_FILE = ".download.json"

_DIGEST_PATTERNS = {"sha256": "[0-9a-f]{64}", "git-sha1": "[0-9a-f]{40}"}


@dataclass(frozen=True, slots=True)
class Digest:
    """Hexadecimal digest of a file's content; ValueError where it is none.

    ``kind`` is ``"sha256"`` for large files and all that a manifest lists, ``"git-sha1"`` for files in git.
    """

    kind: str
    value: str

    def __post_init__(self) -> None:
        if not re.fullmatch(_DIGEST_PATTERNS.get(self.kind, ""), str(self.value)):
            raise ValueError(
                f"{self.value!r} is not a digest of the kind {self.kind!r} in hexadecimal digits"
            )

    def __str__(self) -> str:
        return f"{self.kind} {self.value}"

    def of(self, file: Path) -> Digest:
        """Return the digest of the same kind of a local file, read in pieces."""
        with open_regular(file) as stream:
            return self.of_stream(stream, file.stat().st_size)

    def of_stream(self, stream: IO[bytes], size_bytes: int) -> Digest:
        """Return the digest of the same kind of an open file of that size, read in pieces."""
        found = hashlib.sha256() if self.kind == "sha256" else hashlib.sha1(usedforsecurity=False)
        if self.kind == "git-sha1":
            # Git hashes a head with the size before the content.
            found.update(b"blob %d\0" % size_bytes)
        hashlib.file_digest(stream, lambda: found)  # type: ignore[arg-type]
        return Digest(self.kind, found.hexdigest())


@dataclass(frozen=True, slots=True)
class HubFile:
    """A file of a repository; ``digest`` is None where only a cached copy without one is known."""

    path: str
    size_bytes: int
    digest: Digest | None


@dataclass(frozen=True, slots=True)
class DownloadRecord:
    """Origin of a downloaded folder.

    ``revision`` is the branch or tag that was asked for; ``files`` those that were or are being fetched;
    ``splits`` all of the repository, here or not; ``labels`` which of card and manifest the repository has.
    ``finished`` is False while the download is under way or after it was interrupted.
    """

    repo_id: str
    commit: str
    revision: str | None
    files: Mapping[str, HubFile]
    splits: tuple[str, ...]
    labels: tuple[str, ...]
    finished: bool = True


class _File(msgspec.Struct):
    bytes: Count
    kind: str | None = None
    digest: str | None = None


class _Document(msgspec.Struct, kw_only=True):
    """The form of the file that is believed."""

    repository: str
    commit: str
    revision: str | None = None
    finished: bool = True
    splits: tuple[str, ...]
    labels: tuple[str, ...]
    files: dict[str, _File]


def read_record(folder: DataFolder) -> DownloadRecord | None:
    """Read the record of a folder; None when it was not downloaded, IntegrityError when it is damaged."""
    if not folder.exists(RECORD_FILE):
        return None
    where = folder.address(RECORD_FILE)
    document = decode(folder.read_bytes(RECORD_FILE), _Document, where)
    files = {}
    for path, entry in document.files.items():
        try:
            digest = Digest(entry.kind, str(entry.digest)) if entry.kind is not None else None
        except ValueError as error:
            raise damaged(where, f"files.{path}.digest: {error}") from error
        files[path] = HubFile(path, entry.bytes, digest)
    names_inside((*files, *document.labels), repr(where))
    origin = (document.repository, document.commit, document.revision)
    return DownloadRecord(*origin, files, document.splits, document.labels, document.finished)


def write_record(folder: DataFolder, record: DownloadRecord) -> None:
    """Write the record of a folder in one step."""
    files = {
        path: _File(file.size_bytes, *((file.digest.kind, file.digest.value) if file.digest else ()))
        for path, file in sorted(record.files.items())
    }
    values = {
        "repository": record.repo_id,
        **{name: getattr(record, name) for name in ("commit", "revision", "finished", "splits", "labels")},
        "files": msgspec.to_builtins(files),
    }
    folder.write_bytes(RECORD_FILE, (json.dumps(values, indent=1) + "\n").encode())
