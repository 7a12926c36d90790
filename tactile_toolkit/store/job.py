"""A run writes into a folder only while the manifest there is that of its own data set.

Names of shards are the same in every data set of a kind: a slower run would put its rows among those of a run
that has replaced its set.
"""

from __future__ import annotations

import contextlib
import json
import socket
from collections.abc import Iterator
from contextvars import ContextVar
from dataclasses import dataclass

from tactile_toolkit.errors import InputError
from tactile_toolkit.store.folder import DataFolder
from tactile_toolkit.store.manifest import MANIFEST_FILE, Manifest, read_manifest
from tactile_toolkit.store.parquet import sha256_hex
from tactile_toolkit.store.parts import PartsEndedError

__all__ = ["Job", "putting"]

_seen: dict[Job, object] = {}
"""The version of the manifest that was read last for a job: shards follow each other quickly."""

_at_work: ContextVar[Job | None] = ContextVar("_at_work", default=None)


@dataclass(frozen=True)
class Job:
    """What is being made in a folder; ``of`` is the digest of all that decides its rows and their bytes."""

    folder: DataFolder
    of: str

    @classmethod
    def in_folder(cls, folder: DataFolder) -> Job:
        """Return that of the manifest that is in a folder now."""
        return cls(folder, _digest(read_manifest(folder)))

    def require(self) -> None:
        """Raise PartsEndedError where the manifest is that of another job by now, InputError for none."""
        version = self.folder.version(MANIFEST_FILE)
        if version is not None and _seen.get(self) == version:
            return
        manifest = read_manifest(self.folder)
        if _digest(manifest) != self.of:
            self.folder.refresh("")  # a network file system may have shown what was there a while ago
            manifest = read_manifest(self.folder)
        if manifest is None:
            message = (
                f"node {socket.gethostname()} writes to a folder that this machine does not see, or the data "
                f"set was removed while this run was at work: no {MANIFEST_FILE} is in "
                f"{self.folder.address()!r} there; nothing was written; next: give a folder that all nodes "
                "share, or s3://BUCKET/PATH, and run the same command again"
            )
            raise InputError(message)
        if _digest(manifest) != self.of:
            message = (
                f"the data set in {self.folder.address()!r} was replaced while this run was at work; this "
                "run has stopped and changed nothing of what is there now; next: look there with the command "
                "`info`, or choose another folder (--out or OUT)"
            )
            raise PartsEndedError(message)
        _seen.clear()
        _seen[self] = version

    @contextlib.contextmanager
    def at_work(self) -> Iterator[None]:
        """Have all that this thread does with :func:`putting` be done for this job."""
        token = _at_work.set(self)
        try:
            yield
        finally:
            _at_work.reset(token)


@contextlib.contextmanager
def putting(folder: DataFolder) -> Iterator[None]:
    """Write files of a shard in here: no other run replaces the data set meanwhile, or has done so before."""
    job = _at_work.get()
    with folder.locked(shared=True):
        if job is not None:
            job.require()
        yield


def _digest(manifest: Manifest | None) -> str:
    if manifest is None:
        return ""
    values = (manifest.kind, manifest.toolkit_version, dict(manifest.libraries), manifest.spec)
    return sha256_hex(json.dumps(values, sort_keys=True).encode())
