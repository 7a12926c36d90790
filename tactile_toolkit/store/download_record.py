"""The record of the download that fills a folder: its origin, commit and files.

The Hub names the content of a file by a digest, the only check for a folder without a manifest: SHA-256 for
large files, git's own SHA-1 for files in git. Their lengths distinguish them.
"""

from __future__ import annotations

import hashlib
import io
import re
from pathlib import Path
from typing import IO

import msgspec

from tactile_toolkit.store.files import names_inside, open_regular
from tactile_toolkit.store.folder import DataFolder
from tactile_toolkit.store.sealed_json import Count, decode, require_seal, seal

RECORD_FILE = ".download.json"
DIGEST = re.compile("[0-9a-f]{64}|[0-9a-f]{40}")

_SHA256_DIGITS = 64
_STORED_NAMES = {"repo_id": "repository", "metadata_files": "labels"}


def digest_algorithm(digest: str) -> str:
    """Return the algorithm of a digest, for messages."""
    if len(digest) == _SHA256_DIGITS:
        return "sha256"
    return "git-sha1"


def digest_like(stream: IO[bytes], digest: str) -> str:
    """Return the digest of an open file in hexadecimal, by the algorithm of another digest."""
    if len(digest) == _SHA256_DIGITS:
        found = hashlib.sha256()
    else:  # git hashes a header with the size before the content
        found = hashlib.sha1(b"blob %d\0" % stream.seek(0, io.SEEK_END), usedforsecurity=False)
    stream.seek(0)
    hashlib.file_digest(stream, lambda: found)  # type: ignore[arg-type]
    return found.hexdigest()


def has_digest(path: Path, digest: str) -> bool:
    """Return whether a local file has a digest; all of it is read."""
    with open_regular(path) as stream:
        return digest_like(stream, digest) == digest


class HubFile(msgspec.Struct, frozen=True, omit_defaults=True):
    """A file of a repository; ``digest`` is None if only a cached copy without a digest is known."""

    path: str = ""
    size_bytes: Count = msgspec.field(name="bytes", default=0)
    digest: str | None = None

    def __post_init__(self) -> None:
        if self.digest is not None and not DIGEST.fullmatch(self.digest):
            raise ValueError(f"{self.digest[:80]!r} is not a digest in hexadecimal digits")


class DownloadRecord(msgspec.Struct, frozen=True, rename=_STORED_NAMES):
    """Origin of a downloaded folder.

    ``revision`` is the requested branch or tag; ``files`` are those of the folder; ``splits`` are
    all of the repository, downloaded or not; ``metadata_files`` states which of card and manifest the
    repository has. ``finished`` is False during the download or after it was interrupted.
    """

    repo_id: str
    commit: str
    revision: str | None
    files: dict[str, HubFile]
    splits: tuple[str, ...]
    metadata_files: tuple[str, ...]
    finished: bool = True


def read_download_record(folder: DataFolder) -> DownloadRecord | None:
    """Read the record of a folder; None when it was not downloaded, IntegrityError when it is damaged."""
    if not folder.exists(RECORD_FILE):
        return None
    where = folder.address(RECORD_FILE)
    content = folder.read_bytes(RECORD_FILE)
    record = decode(content, DownloadRecord, where)
    require_seal(content, where)
    names_inside((*record.files, *record.metadata_files), repr(where))
    files = {path: msgspec.structs.replace(file, path=path) for path, file in record.files.items()}
    return msgspec.structs.replace(record, files=files)


def write_download_record(folder: DataFolder, record: DownloadRecord) -> None:
    """Write the record of a folder in one step."""
    files = {path: msgspec.structs.replace(file, path="") for path, file in sorted(record.files.items())}
    content = msgspec.json.encode(msgspec.structs.replace(record, files=files))
    folder.write_bytes(RECORD_FILE, seal(f"{msgspec.json.format(content.decode(), indent=1)}\n").encode())
