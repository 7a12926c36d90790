"""What an upload has to send: local files compared with the Hub's tree. Pure; no disk, no network."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass

__all__ = ["LocalFile", "RemoteFile", "UploadPlan", "compare"]

_HUBS_OWN = frozenset({".gitattributes"})
"""Files that the Hub writes itself and that every repository has."""


@dataclass(frozen=True, slots=True)
class LocalFile:
    """A file of the folder, as it is to be on the Hub.

    Attributes
    ----------
    path : str
        Path inside folder and repository.
    size : int
        Bytes.
    sha256 : str
        Checksum of the content.
    git_oid : str or None
        Name that git gives to the content; None for files so large that the Hub never keeps them in git.
    """

    path: str
    size: int
    sha256: str
    git_oid: str | None


@dataclass(frozen=True, slots=True)
class RemoteFile:
    """A file of a repository.

    Attributes
    ----------
    path : str
        Path inside the repository.
    size : int
        Bytes.
    git_oid : str
        Name of its blob in git: of the content, or of the pointer to a large file.
    sha256 : str or None
        Checksum of a large file; None for one that is kept in git.
    """

    path: str
    size: int
    git_oid: str
    sha256: str | None = None

    def holds(self, file: LocalFile) -> bool:
        """Tell whether its content is that of a local file."""
        if self.size != file.size:
            return False
        return self.sha256 == file.sha256 if self.sha256 is not None else self.git_oid == file.git_oid


@dataclass(frozen=True, slots=True)
class UploadPlan:
    """The difference between a folder and a repository.

    Attributes
    ----------
    new, changed, same : tuple of LocalFile
        Files that the repository lacks, has with another content, has already.
    remote_only : tuple of RemoteFile
        Files that the folder lacks; those that the Hub writes itself are not among them.
    """

    new: tuple[LocalFile, ...]
    changed: tuple[LocalFile, ...]
    same: tuple[LocalFile, ...]
    remote_only: tuple[RemoteFile, ...]

    @property
    def to_send(self) -> tuple[LocalFile, ...]:
        """New and changed files, by path."""
        return tuple(sorted((*self.new, *self.changed), key=lambda file: file.path))

    @property
    def send_bytes(self) -> int:
        """Size of what is to be sent."""
        return sum(file.size for file in self.to_send)

    def is_done(self, *, delete: bool) -> bool:
        """Tell whether the repository holds the folder already (and nothing else, with ``delete``)."""
        return not self.to_send and not (delete and self.remote_only)


def compare(local: Iterable[LocalFile], remote: Mapping[str, RemoteFile]) -> UploadPlan:
    """Compare a folder with a repository by checksums.

    Parameters
    ----------
    local : iterable of LocalFile
        Everything that is to be in the repository.
    remote : mapping of str to RemoteFile
        Its files by path; empty for a repository that does not exist yet.
    """
    files = sorted(local, key=lambda file: file.path)
    known = {file.path for file in files}
    same = tuple(file for file in files if file.path in remote and remote[file.path].holds(file))
    return UploadPlan(
        new=tuple(file for file in files if file.path not in remote),
        changed=tuple(file for file in files if file.path in remote and file not in same),
        same=same,
        remote_only=tuple(
            remote[path] for path in sorted(remote) if path not in known and path not in _HUBS_OWN
        ),
    )
