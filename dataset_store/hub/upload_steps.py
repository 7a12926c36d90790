"""An upload from what the user decides to what it did, as values."""

from __future__ import annotations

import re
from dataclasses import dataclass, field

from dataset_store.errors import InputError
from dataset_store.hub.upload_payload import Payload
from dataset_store.hub.upload_plan import UploadPlan
from dataset_store.hub.upload_target import MAIN, RemoteState, UploadTarget
from dataset_store.manifest import Manifest
from dataset_store.shards import DATA_FOLDER

__all__ = ["PreparedUpload", "UploadOptions", "UploadResult"]

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
