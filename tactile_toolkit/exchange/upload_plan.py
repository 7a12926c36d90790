"""What an upload has to send, decided before anything is: files of the folder compared with the Hub's."""

from __future__ import annotations

import hashlib
import re
from collections.abc import Container, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from fnmatch import fnmatch
from pathlib import Path
from typing import Any

from tactile_toolkit.cards.card import CARD_FILE, PREVIEW_FOLDER, addressed
from tactile_toolkit.cards.croissant import CROISSANT_FILE
from tactile_toolkit.cards.head import config_of, head_text
from tactile_toolkit.errors import InputError
from tactile_toolkit.store.folder import DataFolder
from tactile_toolkit.store.manifest import MANIFEST_FILE, Manifest
from tactile_toolkit.store.names import problem_of_name
from tactile_toolkit.store.origin import HubFile
from tactile_toolkit.store.shards import VIEWER_FOLDER, ShardName
from tactile_toolkit.store.verify import problem_of_place

__all__ = [
    "MAIN",
    "LocalFile",
    "Payload",
    "UploadOptions",
    "UploadPlan",
    "card_for_hub",
    "collect",
    "compare",
]

MAIN = "main"
_COMMIT = re.compile(r"[0-9a-f]{40}")
# Written by the Hub itself; every repository has them.
_WRITTEN_BY_HUB = frozenset({".gitattributes"})
_PICTURE_FOLDER = "images"
_MOST_IN_GIT_BYTES = 10 << 20  # from here on the Hub keeps every file as a large one
_FENCE = "---\n"


@dataclass(frozen=True, slots=True)
class UploadOptions:
    """What the user decides about an upload.

    Attributes
    ----------
    private : bool
        Create the repository so that only its owner sees it.
    revision : str or None
        Branch (made if it is not there) or pull request (``refs/pr/3``) to write to; ``main`` where None.
    create_pr : bool
        Open a pull request instead of writing to the branch.
    message : str or None
        First line of the commit.
    tag : str or None
        Name to give to the commit, beside that of the schema version.
    delete : bool
        Remove files from the repository that the folder does not have.
    viewer : bool
        Send each row once more, with its mesh as a file that the Hub's page shows; without, such files of
        former uploads are removed.
    """

    private: bool = False
    revision: str | None = None
    create_pr: bool = False
    message: str | None = None
    tag: str | None = None
    delete: bool = False
    viewer: bool = False

    def __post_init__(self) -> None:
        if self.create_pr and self.revision not in (None, MAIN):
            message = (
                f"--create-pr and --revision {self.revision} exclude each other: pull requests are opened "
                "against the main branch; next: leave one of them out"
            )
            raise InputError(message)
        pull = "--create-pr" if self.create_pr else f"--revision {self.revision}"
        if self.tag is not None and (self.create_pr or (self.revision or "").startswith("refs/")):
            message = (
                f"{pull} and --tag {self.tag} exclude each other: what is not merged yet gets no name; "
                "next: leave one of them out"
            )
            raise InputError(message)
        # Such names for a branch or tag would be read as something else ever after.
        for option, name in (("--revision", self.revision), ("--tag", self.tag)):
            if name is not None and _COMMIT.fullmatch(name):
                message = f"{option} {name} is the name of a commit; next: give a branch or tag of your own"
                raise InputError(message)
        if self.tag is not None and self.tag == (self.revision or MAIN):
            message = f"--tag {self.tag} is the name of the branch that is written to; next: choose another"
            raise InputError(message)


@dataclass(frozen=True, slots=True)
class LocalFile:
    """A file of the folder, as it is to be on the Hub.

    ``git_oid`` is the name that git gives to the content; None for files so large that the Hub never keeps
    them in git.
    """

    path: str
    size: int
    sha256: str
    git_oid: str | None

    def is_held(self, there: HubFile) -> bool:
        """Tell whether a file of a repository has its content."""
        digests = {"sha256": self.sha256, "git-sha1": self.git_oid}
        found = there.digest
        return self.size == there.size_bytes and found is not None and digests[found.kind] == found.value


@dataclass(frozen=True, slots=True)
class UploadPlan:
    """The difference between a folder and a repository: files that it lacks, has otherwise, has already.

    Of those that the folder lacks, but for what the Hub writes itself, some are ``kept``, others ``removed``.
    """

    new: tuple[LocalFile, ...]
    changed: tuple[LocalFile, ...]
    same: tuple[LocalFile, ...]
    kept: tuple[HubFile, ...]
    removed: tuple[HubFile, ...]

    @property
    def to_send(self) -> tuple[LocalFile, ...]:
        """New and changed files, by path."""
        return tuple(sorted((*self.new, *self.changed), key=lambda file: file.path))

    @property
    def send_bytes(self) -> int:
        """Size of what is to be sent."""
        return sum(file.size for file in self.to_send)

    @property
    def is_done(self) -> bool:
        """Whether the repository holds the folder already, and nothing that is to go."""
        return not (self.new or self.changed or self.removed)


def compare(local: Iterable[LocalFile], remote: Mapping[str, HubFile], *, delete: bool = False) -> UploadPlan:
    """Compare all that is to be in a repository with its files by path, by checksums.

    Of what it has beside them goes what former uploads made for the Hub's page, and all else with ``delete``.
    """
    files = sorted(local, key=lambda file: file.path)
    known = {file.path for file in files}
    there = [(file, file.is_held(remote[file.path])) for file in files if file.path in remote]
    others = [remote[path] for path in sorted(remote) if path not in known and path not in _WRITTEN_BY_HUB]
    goes = [delete or _is_for_page(file.path) for file in others]
    return UploadPlan(
        new=tuple(file for file in files if file.path not in remote),
        changed=tuple(file for file, is_same in there if not is_same),
        same=tuple(file for file, is_same in there if is_same),
        kept=tuple(file for file, is_gone in zip(others, goes, strict=True) if not is_gone),
        removed=tuple(file for file, is_gone in zip(others, goes, strict=True) if is_gone),
    )


def _is_for_page(path: str) -> bool:
    folder, _, name = path.rpartition("/")
    return folder == VIEWER_FOLDER and ShardName.parse(name) is not None


@dataclass(frozen=True)
class Payload:
    """What is sent of a folder: its files, some of them ``rendered`` as they are to be on the Hub.

    ``left_out`` lies in the folder and does not belong to the data set; a folder is named once.
    """

    root: Path
    files: tuple[LocalFile, ...]
    left_out: tuple[str, ...]
    rendered: Mapping[str, bytes | Path] = field(default_factory=dict)

    @property
    def size(self) -> int:
        """Bytes of all files."""
        return sum(file.size for file in self.files)

    def content(self, file: LocalFile) -> bytes | Path:
        """Return what is sent for a file: where it lies, or what it is to be."""
        return self.rendered.get(file.path, self.root / file.path)

    def with_rendered(self, rendered: Mapping[str, bytes | Path]) -> Payload:
        """Return the same with some files rendered: what they hold, or where that lies."""
        others = tuple(file for file in self.files if file.path not in rendered)
        made = tuple(
            _of_content(path, content) if isinstance(content, bytes) else _of_file(content, path, None)
            for path, content in rendered.items()
        )
        return replace(self, rendered=rendered, files=(*made, *others))


def collect(root: Path, manifest: Manifest, elsewhere: Container[str] = ()) -> Payload:
    """List a verified folder's files with their checksums: those of the manifest, the cards, the pictures.

    Of what the manifest lists, some may lie ``elsewhere``.
    """
    known = {record.shard.data_path: record.sha256 for record in manifest.shards}
    known |= {path: digest for path, digest in (manifest.files or {}).items() if path not in elsewhere}
    place, others = DataFolder(str(root)), [CARD_FILE, MANIFEST_FILE]
    others += [CROISSANT_FILE] if place.exists(CROISSANT_FILE) else []
    for folder in (PREVIEW_FOLDER, _PICTURE_FOLDER):
        found = [path.relative_to(root).as_posix() for path in sorted((root / folder).rglob("*"))]
        # Names with a dot in front are of writers that have not finished; links may lead to anything.
        others += [path for path in found if not problem_of_name(path) and not problem_of_place(place, path)]
    files = [_of_file(root / path, path, known.get(path)) for path in dict.fromkeys([*others, *known])]
    sent = {file.path for file in files}
    # A folder of which anything is sent is looked into; any other is named once.
    holding = {parent.as_posix() for path in sent for parent in Path(path).parents}
    return Payload(root, tuple(files), tuple(_unsent(root, root, sent, holding)))


def _of_content(path: str, content: bytes) -> LocalFile:
    # Git's name of a blob; no secret depends on it.
    oid = hashlib.sha1(b"blob %d\0" % len(content) + content, usedforsecurity=False).hexdigest()
    return LocalFile(path, len(content), hashlib.sha256(content).hexdigest(), oid)


def _of_file(file: Path, path: str, sha256: str | None) -> LocalFile:
    size = file.stat().st_size
    if size <= _MOST_IN_GIT_BYTES:
        return _of_content(path, file.read_bytes())
    if sha256 is None:
        with file.open("rb") as stream:
            sha256 = hashlib.file_digest(stream, "sha256").hexdigest()
    return LocalFile(path, size, sha256, None)


def _unsent(root: Path, folder: Path, sent: set[str], holding: set[str]) -> Iterator[str]:
    """Yield what is not sent; a folder of which nothing is sent is named once, with a slash."""
    for entry in sorted(folder.iterdir()):
        path = entry.relative_to(root).as_posix()
        if not entry.is_dir():
            if path not in sent:
                yield path
        elif path not in holding:
            yield f"{path}/"
        else:
            yield from _unsent(root, entry, sent, holding)


def card_for_hub(
    text: str,
    repo_id: str,
    shards: Mapping[str, Sequence[str]],
    others: Iterable[str],
    shown: Mapping[str, Sequence[str]] | None = None,
) -> str:
    """Render the card of a folder for a repository, whose name takes the folder's place in its examples.

    ``shards`` are the files of each split, ``shown`` those for the Hub's page; ``others`` stay in the
    repository though the folder lacks them. Where the pattern of a split would take those for its own, its
    files are named one by one instead.
    """
    import yaml

    named, foreign = addressed(text, repo_id), list(others)
    _, head, body = named.split(_FENCE, 2)
    values: dict[str, Any] = yaml.safe_load(head)
    default = values["configs"][0]
    wanted = [default, config_of(VIEWER_FOLDER, VIEWER_FOLDER, shown)] if shown else [default]
    changed = wanted != values["configs"]
    values["configs"] = wanted
    for config, files in zip(wanted, (shards, shown or {}), strict=False):
        for entry in config["data_files"]:
            patterns = [entry["path"]] if isinstance(entry["path"], str) else entry["path"]
            if any(fnmatch(path, pattern) for pattern in patterns for path in foreign):
                entry["path"] = list(files[entry["split"]])
                changed = True
    return head_text(values) + body if changed else named
