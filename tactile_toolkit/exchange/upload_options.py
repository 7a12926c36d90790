"""Options of an upload, apart from the upload itself: a command line reads them before any library."""

from __future__ import annotations

from dataclasses import dataclass

from tactile_toolkit.checked_fields import switch, text
from tactile_toolkit.errors import InputError

MAIN_BRANCH = "main"


@dataclass(frozen=True, slots=True)
class UploadOptions:
    """Options of an upload.

    Attributes
    ----------
    private : bool
        Create the repository so that only its owner sees it.
    revision : str or None
        Branch (created if missing) or pull request (``refs/pr/3``) to write to; ``main`` if None.
    create_pr : bool
        Open a pull request against the main branch instead of writing to it.
    message : str or None
        First line of the commit.
    tag : str or None
        Tag of the commit; not with ``create_pr``.
    delete : bool
        Remove files from the repository that the folder does not have.
    viewer : bool
        Also send each row with its mesh as a file that the Hub's page shows; otherwise such files of former
        uploads are removed.
    """

    private: bool = switch(False, help="Create a private repository.")
    revision: str | None = text(
        name="--branch", metavar="NAME", help="Branch to write to; created if it does not exist."
    )
    create_pr: bool = switch(False, help="Open a pull request instead of writing to main.")
    message: str | None = text(metavar="TEXT", help="First line of the commit.")
    tag: str | None = text(metavar="NAME", help="Tag of this version, such as v1.")
    delete: bool = switch(False, help="Remove files from the repository that are not in the folder.")
    viewer: bool = switch(False, help="Also send each mesh as a file that the Hub shows in 3D.")

    @property
    def branch(self) -> str:
        """Name of the branch, or of the pull request, to write to."""
        return self.revision or MAIN_BRANCH

    @property
    def is_main(self) -> bool:
        """Whether the main branch is written to."""
        return self.branch == MAIN_BRANCH

    def __post_init__(self) -> None:
        if self.create_pr and (self.tag or not self.is_main):
            raise InputError(
                "and a tag or another branch exclude each other",
                next="leave one of them out",
                field="create_pr",
            )
