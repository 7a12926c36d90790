"""Fetching one file of the Hub: gone on with where it broke off, checked, and whole or not there at all.

What has arrived lies in a stage file beside the place where the whole file will stand. A later try, of this
process or of another one after a kill, asks only for the bytes that are missing.
"""

from __future__ import annotations

import contextlib
import fcntl
import hashlib
import os
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from importlib import import_module
from pathlib import Path
from typing import IO, Any

from tactile_toolkit.errors import IntegrityError
from tactile_toolkit.hub.retry import ask
from tactile_toolkit.read.parquet import cache_folder
from tactile_toolkit.store.origin import Digest

__all__ = ["Transfer", "fetch_whole", "is_whole", "remember_whole"]


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


class _CutShortError(ConnectionResetError):
    """An answer ended before the file did."""


def _silent(_: object) -> None:
    """Tell nobody."""


@dataclass(frozen=True, slots=True)
class Transfer:
    """A file to fetch.

    Attributes
    ----------
    repo_id : str
        ``USER/NAME``, for messages.
    path : str
        Place of the file in the repository, for messages.
    url : str
        Address of its content.
    size_bytes : int
        Its size.
    digest : Digest
        What it must be.
    on_bytes : callable
        Told the number of bytes each time some have arrived; negative when bytes were thrown away.
    on_wait : callable
        Told, in a sentence, why there is a wait.
    """

    repo_id: str
    path: str
    url: str
    size_bytes: int
    digest: Digest
    on_bytes: Callable[[int], None] = field(default=_silent, compare=False)
    on_wait: Callable[[str], None] = field(default=_silent, compare=False)


def fetch_whole(transfer: Transfer, place: Path, stage: Path) -> None:
    """Fetch a file to its place; what has arrived before in the stage file is kept.

    Parameters
    ----------
    transfer : Transfer
        The file.
    place : Path
        Where it is to stand. Nothing happens when something stands there already.
    stage : Path
        File on the same file system that collects what arrives.

    Raises
    ------
    IntegrityError
        It arrived damaged twice; nothing of it is kept.
    HubError
        The Hub or the network failed; what has arrived is kept in the stage file.
    StorageError
        No space, or no permission.
    """
    stage.parent.mkdir(parents=True, exist_ok=True)
    place.parent.mkdir(parents=True, exist_ok=True)
    with _alone(stage) as stream:
        if place.exists():
            stage.unlink(missing_ok=True)
            return
        for _attempt in range(2):
            _fill(transfer, stream)
            found = transfer.digest.of(stage)
            if found == transfer.digest:
                os.fsync(stream.fileno())
                stage.replace(place)
                remember_whole(place, transfer.digest)
                return
            transfer.on_bytes(-transfer.size_bytes)
            stream.truncate(0)
        stage.unlink()
    message = (
        f"{transfer.path!r} of Hub data set {transfer.repo_id!r} arrived damaged twice: {found}, expected "
        f"{transfer.digest}; nothing of it was kept; next: try again later or through another network"
    )
    raise IntegrityError(message)


@contextlib.contextmanager
def _alone(stage: Path) -> Iterator[IO[bytes]]:
    """Open the stage file for appending, and wait while another process fills it."""
    while True:
        with stage.open("ab", buffering=0) as stream:
            with contextlib.suppress(OSError):
                # Where locks are not known, two processes may spoil the file: the checksum then finds out.
                fcntl.flock(stream, fcntl.LOCK_EX)
            if _is_still(stage, stream):
                yield stream
                return


def _is_still(stage: Path, stream: IO[bytes]) -> bool:
    """Tell whether the open file still has its name; another process may have finished or dropped it."""
    try:
        return stage.stat().st_ino == os.fstat(stream.fileno()).st_ino
    except FileNotFoundError:
        return False


def _fill(transfer: Transfer, stream: IO[bytes]) -> None:
    """Ask for what is missing until nothing is; the count of tries starts anew whenever some arrived."""
    if _length(stream) > transfer.size_bytes:
        stream.truncate(0)
    seen = _length(stream)
    transfer.on_bytes(seen)

    def has_moved() -> bool:
        nonlocal seen
        before, seen = seen, _length(stream)
        return seen > before

    doing = f"fetching {transfer.path!r} of"
    if seen < transfer.size_bytes:
        ask(
            lambda: _receive(transfer, stream),
            transfer.repo_id,
            doing=doing,
            has_moved=has_moved,
            on_wait=transfer.on_wait,
        )


def _length(stream: IO[bytes]) -> int:
    return os.fstat(stream.fileno()).st_size


def _receive(transfer: Transfer, stream: IO[bytes]) -> None:
    """Ask once for all that is missing and append what comes."""
    from huggingface_hub import constants

    client: Any = import_module("huggingface_hub.utils")  # its names are not exported to type checkers
    have = _length(stream)
    headers = client.build_hf_headers() | {"Accept-Encoding": "identity"}
    if have:
        headers["Range"] = f"bytes={have}-"
    timeout_s = constants.HF_HUB_DOWNLOAD_TIMEOUT
    session = client.get_session()
    with session.stream(
        "GET", transfer.url, headers=headers, timeout=timeout_s, follow_redirects=True
    ) as answer:
        if answer.status_code == 416:
            _start_again(transfer, stream)
            raise _CutShortError
        client.hf_raise_for_status(answer)
        if have and not _goes_on_at(answer, have):
            _start_again(transfer, stream)
        _append(transfer, stream, answer)
    if _length(stream) < transfer.size_bytes:
        raise _CutShortError


def _goes_on_at(answer: Any, have: int) -> bool:
    begin: str = answer.headers.get("Content-Range", "")
    return answer.status_code == 206 and begin.startswith(f"bytes {have}-")


def _start_again(transfer: Transfer, stream: IO[bytes]) -> None:
    transfer.on_bytes(-_length(stream))
    stream.truncate(0)


def _append(transfer: Transfer, stream: IO[bytes], answer: Any) -> None:
    left = transfer.size_bytes - _length(stream)
    for piece in answer.iter_bytes():
        _write(stream, piece[:left])
        transfer.on_bytes(min(len(piece), left))
        left -= len(piece)
        if left <= 0:
            return


def _write(stream: IO[bytes], piece: bytes) -> None:
    # Unbuffered, so that a kill loses nothing that has arrived; a nearly full disk takes less than it gets.
    view = memoryview(piece)
    while view:
        view = view[stream.write(view) :]
