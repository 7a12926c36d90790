"""The repository that an upload goes to: what it holds, and the few requests that change it."""

from __future__ import annotations

import glob
import warnings
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, TypeVar

from dataset_store.hub.retries import ask
from dataset_store.hub.upload_plan import RemoteFile

__all__ = ["RemoteState", "Sent", "UploadTarget"]

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
