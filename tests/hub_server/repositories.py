"""Content of the server: accounts, and repositories with their entire history."""

from __future__ import annotations

import hashlib
import json
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path, PurePosixPath

LFS_SUFFIXES = frozenset({".arrow", ".avi", ".bin", ".npy", ".parquet", ".png", ".stl", ".zip"})
_LFS_LIMIT = 10 << 20


def git_blob_oid(content: bytes) -> str:
    """Return the name that git gives to a file's content."""
    return hashlib.sha1(b"blob %d\0" % len(content) + content).hexdigest()


@dataclass(frozen=True)
class Account:
    """The user of a token, and its permissions."""

    name: str
    role: str = "write"
    organizations: tuple[str, ...] = ()

    def owns(self, namespace: str) -> bool:
        """Whether the account may hold repositories under a name."""
        return namespace in (self.name, *self.organizations)


@dataclass(frozen=True)
class Blob:
    """Content of a file, kept in git itself or as a large file."""

    content: bytes
    is_lfs: bool

    @cached_property
    def sha256(self) -> str:
        """SHA-256 of the content."""
        return hashlib.sha256(self.content).hexdigest()

    @cached_property
    def pointer(self) -> bytes:
        """The pointer that git stores in place of a large file."""
        head = "version https://git-lfs.github.com/spec/v1"
        return f"{head}\noid sha256:{self.sha256}\nsize {len(self.content)}\n".encode()

    @cached_property
    def oid(self) -> str:
        """Name of the blob in git."""
        return git_blob_oid(self.pointer if self.is_lfs else self.content)

    @property
    def etag(self) -> str:
        """Digest of the content on the Hub: SHA-256 of a large file, the name in git of any other."""
        return self.sha256 if self.is_lfs else self.oid


@dataclass(frozen=True)
class Commit:
    """One state of a repository."""

    sha: str
    files: dict[str, Blob]
    title: str
    description: str
    author: str
    parent: str | None


@dataclass
class Repository:
    """A repository with its history, its names of commits, and its permissions."""

    id: str
    kind: str = "datasets"
    private: bool = False
    gated: str | bool = False
    granted: set[str] = field(default_factory=set)
    """Accounts that have passed the gate."""
    lfs_suffixes: frozenset[str] = LFS_SUFFIXES
    commits: dict[str, Commit] = field(default_factory=dict)
    branches: dict[str, str] = field(default_factory=dict)
    tags: dict[str, str] = field(default_factory=dict)
    pulls: dict[int, str] = field(default_factory=dict)
    objects: dict[str, bytes] = field(default_factory=dict)
    """Large files that were uploaded, by SHA-256, whether committed yet or not."""
    mirrored: dict[str, tuple[int, int]] = field(default_factory=dict)

    def __post_init__(self) -> None:
        self.commit({}, "initial commit", author=self.namespace)

    @property
    def namespace(self) -> str:
        """User or organization that owns it."""
        return self.id.split("/")[0]

    @property
    def head(self) -> Commit:
        """Newest commit of ``main``."""
        return self.commits[self.branches["main"]]

    @property
    def history(self) -> list[Commit]:
        """Commits of ``main``, newest first."""
        return self.log(self.head)

    def log(self, last: Commit) -> list[Commit]:
        """Return a commit and all before it."""
        found = [last]
        while found[-1].parent:
            found.append(self.commits[found[-1].parent])
        return found

    def blob(self, path: str, content: bytes) -> Blob:
        """Decide by name and content whether a file is stored as a large file."""
        return Blob(content, self.is_lfs(path, len(content), content[:512]))

    def is_lfs(self, path: str, size: int, sample: bytes) -> bool:
        """Return whether a file is kept as a large one."""
        suffix = PurePosixPath(path).suffix
        binary = b"\0" in sample and bool(self.lfs_suffixes)
        return size > 0 and (suffix in self.lfs_suffixes or binary or size > _LFS_LIMIT)

    def find(self, revision: str) -> Commit | None:
        """Return the commit that a branch, tag, pull request or sha names."""
        number = revision.removeprefix("refs/pr/")
        sha = (
            self.branches.get(revision.removeprefix("refs/heads/"))
            or self.tags.get(revision)
            or (self.pulls.get(int(number)) if number.isdigit() and number != revision else None)
            or revision
        )
        return self.commits.get(sha)

    def commit(
        self,
        changes: dict[str, Blob | None],
        title: str,
        *,
        description: str = "",
        author: str = "",
        ref: str = "main",
    ) -> Commit:
        """Add a commit on a branch or pull request (``refs/pr/N``); None removes a path or a folder."""
        base = self.find(ref)
        files = dict(base.files) if base else {}
        for path, blob in changes.items():
            if blob is None:
                gone = [name for name in files if name == path or name.startswith(path.rstrip("/") + "/")]
                for name in gone:
                    del files[name]
            else:
                files[path] = blob
                if blob.is_lfs:
                    self.objects[blob.sha256] = blob.content
        tree = {path: blob.oid for path, blob in sorted(files.items())}
        parent = base.sha if base else None
        text = json.dumps([self.id, tree, title, description, author, parent, len(self.commits)])
        made = Commit(hashlib.sha1(text.encode()).hexdigest(), files, title, description, author, parent)
        self.commits[made.sha] = made
        self._point(ref, made.sha)
        return made

    def _point(self, ref: str, sha: str) -> None:
        if ref.startswith("refs/pr/"):
            self.pulls[int(ref.removeprefix("refs/pr/"))] = sha
        else:
            self.branches[ref.removeprefix("refs/heads/")] = sha

    def open_pull(self) -> str:
        """Open a pull request at the head of ``main`` and return its name."""
        number = len(self.pulls) + 1
        self.pulls[number] = self.branches["main"]
        return f"refs/pr/{number}"

    def mirror(self, folder: Path) -> None:
        """Commit the changes of a folder since the last call."""
        found = {
            str(file.relative_to(folder)): (file.stat().st_size, file.stat().st_mtime_ns)
            for file in sorted(folder.rglob("*"))
            if file.is_file()
        }
        changes: dict[str, Blob | None] = {
            path: self.blob(path, (folder / path).read_bytes())
            for path, state in found.items()
            if self.mirrored.get(path) != state
        }
        changes |= dict.fromkeys(self.mirrored.keys() - found.keys())
        self.mirrored = found
        if changes:
            self.commit(changes, "files of a folder", author=self.namespace)
