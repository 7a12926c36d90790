"""Which files of a folder are the data set, and which only lie beside it."""

from __future__ import annotations

import contextlib
import hashlib
import tempfile
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace
from pathlib import Path

from dataset_store.cards.card import CARD_FILE
from dataset_store.cards.pictures import PREVIEW_FOLDER
from dataset_store.hub.upload_plan import LocalFile
from dataset_store.manifest import MANIFEST_FILE, Manifest

__all__ = ["Payload", "collect", "staged"]

_PICTURE_FOLDER = "images"
_MOST_IN_GIT = 10 << 20
"""Bytes from which on the Hub keeps every file as a large one."""


@dataclass(frozen=True)
class Payload:
    """What is sent of a folder.

    Attributes
    ----------
    root : Path
        The folder.
    card : bytes
        The card as it is to be on the Hub.
    files : tuple of LocalFile
        Everything that is to be on the Hub, the card too.
    left_out : tuple of str
        What lies in the folder and is no part of the data set; a folder is named once.
    """

    root: Path
    card: bytes
    files: tuple[LocalFile, ...]
    left_out: tuple[str, ...]

    @property
    def size(self) -> int:
        """Bytes of all files."""
        return sum(file.size for file in self.files)

    def with_card(self, card: bytes) -> Payload:
        """Return the same with another card."""
        others = tuple(file for file in self.files if file.path != CARD_FILE)
        return replace(self, card=card, files=(_of_content(CARD_FILE, card), *others))


def collect(root: Path, manifest: Manifest, card: bytes) -> Payload:
    """List the data set's files with their checksums: those of the manifest, the card, the pictures.

    Parameters
    ----------
    root : Path
        A verified folder.
    manifest : Manifest
        Its manifest; checksums of shards are taken from it.
    card : bytes
        The card as it is to be on the Hub.
    """
    known = {receipt.shard.data_path: receipt.sha256 for receipt in manifest.receipts}
    known |= dict(manifest.files or {})
    others = [MANIFEST_FILE, *_files_under(root, PREVIEW_FOLDER), *_files_under(root, _PICTURE_FOLDER)]
    files = [
        _of_content(CARD_FILE, card),
        *(_of_file(root, path, known.get(path)) for path in dict.fromkeys([*known, *others])),
    ]
    sent = {file.path for file in files}
    return Payload(root, card, tuple(files), tuple(_strangers(root, sent)))


def _files_under(root: Path, folder: str) -> list[str]:
    """List whole files below a folder; names with a dot in front are of writers that have not finished."""
    found = sorted((root / folder).rglob("*"))
    paths = [path.relative_to(root) for path in found if path.is_file()]
    return [path.as_posix() for path in paths if not any(part.startswith(".") for part in path.parts)]


def _of_content(path: str, content: bytes) -> LocalFile:
    return LocalFile(path, len(content), hashlib.sha256(content).hexdigest(), _git_oid(content))


def _of_file(root: Path, path: str, sha256: str | None) -> LocalFile:
    place = root / path
    size = place.stat().st_size
    if size > _MOST_IN_GIT:
        return LocalFile(path, size, sha256 or _sha256(place), None)
    return _of_content(path, place.read_bytes())


def _sha256(place: Path) -> str:
    with place.open("rb") as stream:
        return hashlib.file_digest(stream, "sha256").hexdigest()


def _git_oid(content: bytes) -> str:
    # Git's name of a blob; no secret depends on it.
    return hashlib.sha1(b"blob %d\0" % len(content) + content, usedforsecurity=False).hexdigest()


def _strangers(root: Path, sent: set[str]) -> Iterator[str]:
    """Yield what is not sent; a folder of which nothing is sent is named once, with a slash."""
    holding = {parent.as_posix() for path in sent for parent in Path(path).parents}
    for place in sorted(root.iterdir()):
        yield from _strangers_at(root, place, sent, holding)


def _strangers_at(root: Path, place: Path, sent: set[str], holding: set[str]) -> Iterator[str]:
    path = place.relative_to(root).as_posix()
    if not place.is_dir():
        if path not in sent:
            yield path
    elif path not in holding:
        yield f"{path}/"
    else:
        for inner in sorted(place.iterdir()):
            yield from _strangers_at(root, inner, sent, holding)


@contextlib.contextmanager
def staged(payload: Payload, files: Iterable[LocalFile]) -> Iterator[Path]:
    """Lay out some files of a payload in a folder of their own: links, and the card as it is to be.

    What is not among them cannot be sent by mistake, and what the Hub has already is not even read.
    """
    with tempfile.TemporaryDirectory(prefix="tactile-upload-") as name:
        stage = Path(name)
        for file in files:
            place = stage / file.path
            place.parent.mkdir(parents=True, exist_ok=True)
            if file.path == CARD_FILE:
                place.write_bytes(payload.card)
            else:
                place.symlink_to((payload.root / file.path).resolve())
        yield stage
