"""The repository that an upload goes to: what it holds, and the few requests that change it."""

from __future__ import annotations

import contextlib
import glob
import hashlib
import re
import tempfile
import warnings
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, TypeVar

from tactile_toolkit.cards.card import CARD_FILE, PREVIEW_FOLDER
from tactile_toolkit.errors import InputError
from tactile_toolkit.exchange.upload_plan import LocalFile, RemoteFile, UploadPlan
from tactile_toolkit.hub.retry import ask
from tactile_toolkit.store.manifest import MANIFEST_FILE, Manifest
from tactile_toolkit.store.shards import DATA_FOLDER

__all__ = [
    "Payload",
    "PreparedUpload",
    "RemoteState",
    "Sent",
    "UploadOptions",
    "UploadResult",
    "UploadTarget",
    "collect",
    "staged",
]

MAIN = "main"
_KIND = "dataset"
_PULLS_SEEN = 10

T = TypeVar("T")


@dataclass(frozen=True)
class RemoteState:
    """A branch of a repository as it is now.

    Attributes
    ----------
    exists : bool
        Whether there is such a repository.
    private : bool
        Whether only its owner sees it.
    head : str or None
        Commit that the branch points to, or that it will start at: the head of ``main``.
    files : dict of str to RemoteFile
        What that commit holds.
    tags : dict of str to str
        Commit of each tag.
    branches : frozenset of str
        Names of the branches.
    has_branch : bool
        Whether the branch is there; False where it is still to be made.
    """

    exists: bool
    private: bool = False
    head: str | None = None
    files: dict[str, RemoteFile] = field(default_factory=dict)
    tags: dict[str, str] = field(default_factory=dict)
    branches: frozenset[str] = frozenset()
    has_branch: bool = False


@dataclass(frozen=True, slots=True)
class Sent:
    """Where a commit went.

    Attributes
    ----------
    commit : str
        Its id.
    pull : str or None
        The pull request it opened, such as ``"refs/pr/3"``.
    """

    commit: str
    pull: str | None = None


@dataclass(frozen=True)
class UploadTarget:
    """A branch of a data set repository, or a pull request to be opened.

    Parameters
    ----------
    repo_id : str
        ``USER/NAME``.
    branch : str
        Branch that is written to.
    on_wait : callable
        Told, in a sentence, of each wait before a request is tried again.
    """

    repo_id: str
    branch: str = MAIN
    on_wait: Callable[[str], None] = field(default=lambda _: None, repr=False, compare=False)

    @property
    def page(self) -> str:
        """Address of the repository for people."""
        from huggingface_hub import constants

        return f"{constants.ENDPOINT}/datasets/{self.repo_id}"

    def who(self) -> str:
        """Return the name of the account that is logged in.

        Raises
        ------
        HubError
            Nobody is, or the token is not good.
        """
        return str(self._ask(lambda: self._api().whoami()["name"]))

    def state(self) -> RemoteState:
        """Look what the branch holds; a repository or branch that does not exist is no error."""
        return self._ask(self._state)

    def files_at(self, revision: str) -> dict[str, RemoteFile]:
        """List the files of a commit, tag, branch or pull request."""
        return self._ask(lambda: self._tree(revision))

    def open_pulls(self, author: str) -> list[str]:
        """List the newest open pull requests of an account, such as ``refs/pr/3``; newest first."""
        return self._ask(lambda: self._pulls(author))

    def commit_of(self, revision: str) -> str:
        """Return the commit that a branch or pull request points to."""
        return self._ask(
            lambda: str(self._api().repo_info(self.repo_id, repo_type=_KIND, revision=revision).sha)
        )

    def create(self, *, private: bool) -> None:
        """Create the repository; one that is there already stays as it is."""
        api = self._api()
        self._ask(lambda: api.create_repo(self.repo_id, repo_type=_KIND, private=private, exist_ok=True))

    def create_branch(self, start: str | None) -> None:
        """Create the branch at a commit, or at the head of ``main``; one that is there stays as it is."""
        api = self._api()
        self._ask(
            lambda: api.create_branch(
                self.repo_id, branch=self.branch, revision=start, repo_type=_KIND, exist_ok=True
            )
        )

    def send(self, stage: Path, message: str, *, delete: list[str], parent: str | None, pull: bool) -> Sent:
        """Send a folder as a commit, once: a lost answer is looked into, not repeated, by the caller.

        Parameters
        ----------
        stage : Path
            Folder of which everything is sent.
        message : str
            First line of the commit.
        delete : list of str
            Files to remove from the repository.
        parent : str or None
            Commit that the branch must still point to.
        pull : bool
            Open a pull request instead of writing to the branch.
        """
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # the client library's own, which no user can heed
            made = self._api().upload_folder(
                repo_id=self.repo_id,
                folder_path=stage,
                repo_type=_KIND,
                commit_message=message,
                revision=None if pull else self.branch,
                create_pr=pull,
                parent_commit=None if pull else parent,
                delete_patterns=[glob.escape(path) for path in delete] or None,
            )
        return Sent(made.oid, made.pr_revision)

    def set_tag(self, name: str, commit: str, there: str | None) -> None:
        """Make a tag name a commit; one that names another is moved."""
        api = self._api()
        if there is not None:
            self._ask(lambda: api.delete_tag(self.repo_id, tag=name, repo_type=_KIND))
        self._ask(
            lambda: api.create_tag(self.repo_id, tag=name, revision=commit, repo_type=_KIND, exist_ok=True)
        )

    def _ask(self, action: Callable[[], T]) -> T:
        return ask(action, self.repo_id, self.branch, "uploading to", on_wait=self.on_wait)

    def _api(self) -> Any:
        from huggingface_hub import HfApi

        return HfApi()

    def _state(self) -> RemoteState:
        from huggingface_hub import errors

        api = self._api()
        try:
            private = bool(api.repo_info(self.repo_id, repo_type=_KIND).private)
        except errors.GatedRepoError:
            raise
        except errors.RepositoryNotFoundError:
            return RemoteState(exists=False)
        refs = api.list_repo_refs(self.repo_id, repo_type=_KIND)
        tags = {ref.name: str(ref.target_commit) for ref in refs.tags}
        heads = {ref.name: str(ref.target_commit) for ref in refs.branches}
        there = heads.get(self.branch) or self._pull_head()
        head = there or heads.get(MAIN)
        files = self._tree(head) if head is not None else {}
        return RemoteState(True, private, head, files, tags, frozenset(heads), there is not None)

    def _pull_head(self) -> str | None:
        """Return the commit of a pull request that is written to like a branch."""
        if not self.branch.startswith("refs/"):
            return None
        return str(self._api().repo_info(self.repo_id, repo_type=_KIND, revision=self.branch).sha)

    def _tree(self, revision: str) -> dict[str, RemoteFile]:
        from huggingface_hub.hf_api import RepoFile

        entries = self._api().list_repo_tree(self.repo_id, recursive=True, revision=revision, repo_type=_KIND)
        return {
            entry.path: RemoteFile(
                entry.path, entry.size, entry.blob_id, entry.lfs.sha256 if entry.lfs is not None else None
            )
            for entry in entries
            if isinstance(entry, RepoFile)
        }

    def _pulls(self, author: str) -> list[str]:
        found = self._api().get_repo_discussions(
            self.repo_id,
            repo_type=_KIND,
            author=author,
            discussion_type="pull_request",
            discussion_status="open",
        )
        numbers = sorted((entry.num for entry in found), reverse=True)
        return [f"refs/pr/{number}" for number in numbers[:_PULLS_SEEN]]


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
    known = {record.shard.data_path: record.sha256 for record in manifest.shards}
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


_COMMIT = re.compile(r"[0-9a-f]{40}")


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
    """

    private: bool = False
    revision: str | None = None
    create_pr: bool = False
    message: str | None = None
    tag: str | None = None
    delete: bool = False

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
        self._refuse_names_of_commits()

    def _refuse_names_of_commits(self) -> None:
        """Refuse names for a branch or tag that would be read as something else ever after."""
        for option, name in (("--revision", self.revision), ("--tag", self.tag)):
            if name is not None and _COMMIT.fullmatch(name):
                message = f"{option} {name} is the name of a commit; next: give a branch or tag of your own"
                raise InputError(message)
        if self.tag is not None and self.tag == (self.revision or MAIN):
            message = f"--tag {self.tag} is the name of the branch that is written to; next: choose another"
            raise InputError(message)


@dataclass(frozen=True)
class PreparedUpload:
    """An upload that is decided and not begun.

    Attributes
    ----------
    target : UploadTarget
        Where it goes.
    options : UploadOptions
        As given.
    manifest : Manifest
        Of the folder.
    payload : Payload
        What the folder has.
    state : RemoteState
        What the Hub has.
    plan : UploadPlan
        The difference.
    pull : str or None
        An open pull request that holds everything already.
    """

    target: UploadTarget
    options: UploadOptions
    manifest: Manifest
    payload: Payload
    state: RemoteState
    plan: UploadPlan
    pull: str | None = None

    @property
    def is_done(self) -> bool:
        """Whether nothing is to be sent or removed."""
        return self.pull is not None or self.plan.is_done(delete=self.options.delete)

    @property
    def removed(self) -> tuple[str, ...]:
        """Files of the repository that are to be removed."""
        return tuple(file.path for file in self.plan.remote_only) if self.options.delete else ()

    @property
    def kept(self) -> tuple[str, ...]:
        """Files of the repository that the folder lacks and that stay."""
        return () if self.options.delete else tuple(file.path for file in self.plan.remote_only)

    @property
    def mixed(self) -> tuple[str, ...]:
        """Files among those kept that have names of shards of the folder's splits, but are none."""
        shards = tuple(f"{DATA_FOLDER}/{split}-" for split in self.manifest.splits)
        return tuple(path for path in self.kept if path.startswith(shards))

    @property
    def tags(self) -> tuple[str, ...]:
        """Names that the commit gets: the schema version's on the main branch, and the user's."""
        if self.options.create_pr or self.target.branch.startswith("refs/"):
            return ()
        schema = [f"schema-{self.manifest.schema_version}"] if self.target.branch == MAIN else []
        return tuple(dict.fromkeys([*schema, *([self.options.tag] if self.options.tag else [])]))

    @property
    def message(self) -> str:
        """First line of the commit."""
        made = f"{self.manifest.kind} made by tactile-toolkit {self.manifest.toolkit_version}"
        return self.options.message or f"Upload {made}"


@dataclass(frozen=True)
class UploadResult:
    """What an upload did.

    Attributes
    ----------
    commit : str
        Commit that holds the folder.
    pull : str or None
        Pull request that holds it, if it is not on a branch.
    sent : tuple of str
        Files sent by this call.
    removed : tuple of str
        Files removed by this call.
    tags : tuple of str
        Names set by this call.
    """

    commit: str
    pull: str | None = None
    sent: tuple[str, ...] = field(default=())
    removed: tuple[str, ...] = field(default=())
    tags: tuple[str, ...] = field(default=())
