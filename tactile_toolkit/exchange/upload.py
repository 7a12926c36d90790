"""Bringing a data set folder to the Hugging Face Hub.

First everything is looked at and nothing is changed (:func:`prepare_upload`): is the folder whole, what has
the Hub already. Then what is missing is sent (:func:`run_upload`), and what arrived is compared by checksum.
"""

from __future__ import annotations

import warnings
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import Any, TypeVar

from tactile_toolkit.cards.card import CARD_FILE
from tactile_toolkit.cards.checks import check_card
from tactile_toolkit.cards.croissant import CROISSANT_FILE, croissant_for_hub
from tactile_toolkit.cards.facts import viewer_files
from tactile_toolkit.catalog.kinds import require_manifest
from tactile_toolkit.errors import InputError, IntegrityError
from tactile_toolkit.exchange.local_copy import LocalCopy
from tactile_toolkit.exchange.upload_plan import (
    MAIN,
    Payload,
    UploadOptions,
    UploadPlan,
    card_for_hub,
    collect,
    compare,
)
from tactile_toolkit.exchange.viewer import ViewerFiles
from tactile_toolkit.hub.errors import require_repository_name
from tactile_toolkit.hub.repository import HubSnapshot, listing
from tactile_toolkit.hub.retry import ask
from tactile_toolkit.kind import DatasetKind
from tactile_toolkit.store.folder import DataFolder
from tactile_toolkit.store.manifest import MANIFEST_FILE, Manifest, read_manifest
from tactile_toolkit.store.origin import HubFile
from tactile_toolkit.store.shards import DATA_FOLDER, Finding
from tactile_toolkit.store.verify import verify

__all__ = [
    "PreparedUpload",
    "UploadResult",
    "check_folder",
    "prepare_upload",
    "run_upload",
]

_REPO_TYPE = "dataset"
# All files of each are listed and compared.
_PULLS_SEEN = 10

T = TypeVar("T")


@dataclass(frozen=True)
class RemoteState:
    """A branch of a repository as it is now.

    Attributes
    ----------
    held : HubSnapshot or None
        What the commit holds that the branch points to, or that it will start at: the head of ``main``. None
        where there is no such repository.
    tags : dict of str to str
        Commit of each tag.
    branches : frozenset of str
        Names of the branches.
    has_branch : bool
        Whether the branch is there; False where it is still to be made.
    """

    held: HubSnapshot | None = None
    tags: Mapping[str, str] = field(default_factory=dict)
    branches: frozenset[str] = frozenset()
    has_branch: bool = False

    @property
    def exists(self) -> bool:
        """Whether there is such a repository."""
        return self.held is not None

    @property
    def private(self) -> bool:
        """Whether only its owner sees it."""
        return self.held is not None and self.held.is_private

    @property
    def head(self) -> str | None:
        """The commit that is there."""
        return self.held.commit if self.held is not None else None

    @property
    def files(self) -> Mapping[str, HubFile]:
        """What that holds."""
        return self.held.files if self.held is not None else {}


@dataclass(frozen=True)
class UploadTarget:
    """A branch of a data set repository, or a pull request to be opened; ``on_wait`` is told of each wait."""

    repo_id: str
    branch: str = MAIN
    on_wait: Callable[[str], None] = field(default=lambda _: None, repr=False, compare=False)

    @property
    def page(self) -> str:
        """Address of the repository for people."""
        from huggingface_hub import constants

        return f"{constants.ENDPOINT}/datasets/{self.repo_id}"

    def who(self) -> str:
        """Return the name of the account that is logged in; HubError if nobody is."""
        return str(self._ask(lambda: self._api().whoami()["name"]))

    def state(self) -> RemoteState:
        """Look what the branch holds; a repository or branch that does not exist is not an error."""
        return self._ask(self._state)

    def at(self, revision: str) -> HubSnapshot:
        """List the files of a commit, tag, branch or pull request."""
        return self._ask(lambda: listing(self.repo_id, revision, in_pages=True))

    def open_pulls(self, author: str) -> list[str]:
        """List the newest open pull requests of an account, such as ``refs/pr/3``; newest first."""

        def pulls() -> list[int]:
            wanted = {"author": author, "discussion_type": "pull_request", "discussion_status": "open"}
            found = self._api().get_repo_discussions(self.repo_id, repo_type=_REPO_TYPE, **wanted)
            return sorted((entry.num for entry in found), reverse=True)

        return [f"refs/pr/{number}" for number in self._ask(pulls)[:_PULLS_SEEN]]

    def do(self, what: str, **options: Any) -> Any:
        """Call a method of the Hub's client for this repository, one that may be called once more."""
        return self._ask(lambda: getattr(self._api(), what)(self.repo_id, repo_type=_REPO_TYPE, **options))

    def send(self, prepared: PreparedUpload) -> tuple[str, str | None]:
        """Send what is missing as one commit, once; return that, and the pull request that it opened."""
        from huggingface_hub import CommitOperationAdd, CommitOperationDelete

        plan, pull = prepared.plan, prepared.options.create_pr
        added = [CommitOperationAdd(file.path, prepared.payload.content(file)) for file in plan.to_send]
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # the client library's own, which no user can heed
            made = self._api().create_commit(
                repo_id=self.repo_id,
                operations=[*(CommitOperationDelete(file.path) for file in plan.removed), *added],
                repo_type=_REPO_TYPE,
                commit_message=prepared.message,
                # The Hub opens pull requests against main itself, from wherever that is; only a branch may
                # have moved on.
                revision=None if pull else self.branch,
                create_pr=pull,
                parent_commit=None if pull else prepared.state.head,
            )
        return str(made.oid), made.pr_revision

    def set_tag(self, name: str, commit: str, there: str | None) -> None:
        """Make a tag name a commit; one that names another is moved."""
        if there is not None:
            self.do("delete_tag", tag=name)  # the client moves no tag
        self.do("create_tag", tag=name, revision=commit, exist_ok=True)

    def _ask(self, action: Callable[[], T]) -> T:
        return ask(action, self.repo_id, self.branch, "uploading to", on_wait=self.on_wait)

    def _api(self) -> Any:
        from huggingface_hub import HfApi

        return HfApi()

    def _state(self) -> RemoteState:
        from huggingface_hub import errors

        try:
            refs = self._api().list_repo_refs(self.repo_id, repo_type=_REPO_TYPE)
        # To the client it is a kind of RepositoryNotFoundError, but such a repository is there.
        except errors.GatedRepoError:
            raise
        except errors.RepositoryNotFoundError:
            return RemoteState()
        tags = {ref.name: str(ref.target_commit) for ref in refs.tags}
        heads = {ref.name: str(ref.target_commit) for ref in refs.branches}
        # A pull request that is written to is not listed.
        is_there = self.branch in heads or self.branch.startswith("refs/")
        held = listing(self.repo_id, self.branch if is_there else MAIN, in_pages=True)
        return RemoteState(held, tags, frozenset(heads), is_there)


@dataclass(frozen=True)
class PreparedUpload:
    """An upload that is decided and not begun; ``pull`` is an open pull request that holds everything.

    ``author`` is the account that sends, empty where that was not asked. ``copy`` and ``viewer`` are kept as
    long as this is: the copy on this machine of a folder in an object store, and the files that were made for
    the Hub's page.
    """

    target: UploadTarget
    options: UploadOptions
    manifest: Manifest
    payload: Payload
    state: RemoteState
    author: str = ""
    pull: str | None = None
    copy: LocalCopy | None = None
    viewer: ViewerFiles | None = None

    @cached_property
    def plan(self) -> UploadPlan:
        """What the Hub lacks of the folder, and has beside it."""
        return self._compared(self.state.files)

    def _compared(self, files: Mapping[str, HubFile]) -> UploadPlan:
        return compare(self.payload.files, files, delete=self.options.delete)

    def at(self, state: RemoteState) -> PreparedUpload:
        """Return the upload that is left where the Hub holds that; or a pull request of ours holds all."""
        left = replace(self, state=state, pull=None)
        if self.options.create_pr and state.exists and self.author and not left.is_done:
            for pull in self.target.open_pulls(self.author):
                held = self.target.at(pull)
                if self._compared(held.files).is_done:
                    return replace(left, state=replace(state, held=held), pull=pull)
        return left

    def require_arrival(self, commit: str) -> None:
        """Compare every file of a commit with the folder, by checksum; IntegrityError names what differs."""
        arrived = self._compared(self.target.at(commit).files)
        wrong = [
            *(f"{file.path} is missing" for file in arrived.new),
            *(f"{file.path} differs" for file in arrived.changed),
            *(f"{file.path} is still there" for file in arrived.removed),
        ]
        if wrong:
            message = (
                f"{self.target.repo_id!r} does not hold what was sent (commit {commit[:12]}): "
                f"{'; '.join(wrong[:3])} ({len(wrong)} such files); next: run the same upload again, it "
                "sends what is missing"
            )
            raise IntegrityError(message)

    @property
    def is_done(self) -> bool:
        """Whether nothing is to be sent or removed."""
        return self.pull is not None or self.plan.is_done

    @property
    def removed(self) -> tuple[str, ...]:
        """Files of the repository that are to be removed."""
        return tuple(file.path for file in self.plan.removed)

    @property
    def kept(self) -> tuple[str, ...]:
        """Files of the repository that the folder lacks and that stay."""
        return tuple(file.path for file in self.plan.kept)

    @property
    def mixed(self) -> tuple[str, ...]:
        """Files among those kept that are named like shards of the folder's splits, but are not."""
        shards = tuple(f"{DATA_FOLDER}/{split}-" for split in self.manifest.splits)
        return tuple(path for path in self.kept if path.startswith(shards))

    @property
    def tags(self) -> tuple[str, ...]:
        """Names that the commit gets: the schema version's on the main branch, and the user's."""
        # What is not merged yet may never be.
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
    """What an upload did: files sent and removed and names set by this call, and where the folder is now.

    ``pull`` is the pull request that holds the commit, if it is not on a branch.
    """

    commit: str
    pull: str | None = None
    sent: tuple[str, ...] = ()
    removed: tuple[str, ...] = ()
    tags: tuple[str, ...] = ()


def check_folder(kind: DatasetKind, folder: DataFolder, workers: int = 1) -> Iterable[Finding]:
    """List what is wrong with a folder of a kind: files, rows, columns, ids, pictures, card."""
    if kind.check is not None:
        found: Iterable[Finding] = kind.check(folder, workers)
        return found
    schema = kind.schema_of(require_manifest(kind, folder))
    return verify(folder, schema, check_card=check_card, workers=workers).findings


def prepare_upload(
    folder: str,
    repo_id: str,
    options: UploadOptions | None = None,
    *,
    check: Callable[[DataFolder], Iterable[Finding]] | None = None,
    dry_run: bool = False,
    on_wait: Callable[[str], None] = lambda _: None,
) -> PreparedUpload:
    """Verify a folder, render its card, and compare it with the repository; nothing is changed anywhere.

    ``check`` lists what is wrong with the folder: checksums and card by default. A dry run does without a
    login where the repository can be seen without one. Raises InputError (not a finished data set, an option
    that cannot be used), IntegrityError (damage, a card that does not tell the truth) or HubError.
    """
    chosen = options or UploadOptions()
    require_repository_name(repo_id)
    place, manifest = _finished(folder)
    copy = None if place.is_local else LocalCopy(place)
    root = Path(place.address()) if copy is None else copy.root
    found = DataFolder(str(root))
    _require_sound(folder, list(check(found) if check else verify(found, check_card=check_card).findings))
    target = UploadTarget(repo_id, chosen.revision or MAIN, on_wait)
    name = "" if dry_run else target.who()
    state = target.state()
    _refuse_exposure(target, chosen, state)
    _refuse_taken_names(target, chosen, state)
    viewer = ViewerFiles(found, manifest) if chosen.viewer else None
    if viewer is not None:
        manifest = replace(manifest, files={**(manifest.files or {}), **viewer.digests})
    shown = {} if viewer is None else viewer.places
    payload = _payload(root, folder, manifest, target, chosen, state, shown)
    prepared = PreparedUpload(target, chosen, manifest, payload, state, name, copy=copy, viewer=viewer)
    _refuse_other_tag(prepared)
    return prepared.at(state)


def _finished(folder: str) -> tuple[DataFolder, Manifest]:
    place = DataFolder(folder)
    manifest = read_manifest(place)
    if manifest is None:
        message = (
            f"{place.lacks(MANIFEST_FILE)}: only data sets made by this toolkit can be proved "
            "whole before they are sent; next: give the folder of one"
        )
        raise InputError(message)
    return place, manifest


def _require_sound(folder: str, findings: Sequence[Finding]) -> None:
    if not findings:
        return
    listed = "; ".join(f"{each.file} {each.problem}".partition("; next: ")[0] for each in findings[:3])
    more = f" and {len(findings) - 3} more" if len(findings) > 3 else ""
    cards = {CARD_FILE, CROISSANT_FILE}
    only_card = all(cards.intersection((finding.file, *finding.problem.split())) for finding in findings)
    next_step = (
        "write it with the command `card`, or mend it by hand"
        if only_card
        else "run the command that made it again, or `card` for the card alone"
    )
    message = f"{folder!r} is not fit to be sent, nothing was: {listed}{more}; next: {next_step}"
    raise IntegrityError(message)


def _refuse_exposure(target: UploadTarget, options: UploadOptions, state: RemoteState) -> None:
    if options.private and state.exists and not state.private:
        message = (
            f"{target.repo_id!r} exists and everyone can see it, --private was asked for; nothing was sent; "
            f"next: make it private at {target.page}/settings, or leave --private out"
        )
        raise InputError(message)


def _refuse_taken_names(target: UploadTarget, options: UploadOptions, state: RemoteState) -> None:
    """Refuse a branch named as a tag, and the other way round: readers could not tell one from the other."""
    if options.revision in state.tags and not state.has_branch:
        option, is_a = f"--revision {options.revision}", "a tag, which names one commit for good"
    elif options.tag in state.branches:
        option, is_a = f"--tag {options.tag}", "a branch"
    else:
        return
    message = f"{option}: of {target.repo_id!r} that is {is_a}; nothing was sent; next: choose another name"
    raise InputError(message)


def _refuse_other_tag(prepared: PreparedUpload) -> None:
    """Refuse a name of the user's that another commit has: only the schema's name moves along."""
    tag = prepared.options.tag
    there = prepared.state.tags.get(tag) if tag else None
    if there is not None and not (prepared.is_done and there == prepared.state.head):
        message = (
            f"tag {tag!r} of {prepared.target.repo_id!r} names commit {there[:12]} already; nothing was "
            "sent; next: choose another --tag, or delete that one on the Hub"
        )
        raise InputError(message)


def _payload(
    root: Path,
    folder: str,
    manifest: Manifest,
    target: UploadTarget,
    options: UploadOptions,
    state: RemoteState,
    shown: Mapping[str, Path],
) -> Payload:
    """Collect the files, with the cards as they are to be on the Hub, checked as such.

    ``shown`` are the files for the Hub's page, by path.
    """
    payload = collect(root, manifest, shown)
    others = [file.path for file in compare(payload.files, state.files, delete=options.delete).kept]
    stored = (root / CARD_FILE).read_text(encoding="utf-8")
    shards = {split: [r.shard.data_path for r in manifest.shards_of(split)] for split in manifest.splits}
    text = card_for_hub(stored, target.repo_id, shards, others, viewer_files(manifest))
    held = {*(file.path for file in payload.files), *others}
    _require_sound(folder, check_card(DataFolder(str(root)), text, held=held, manifest=manifest))
    described = (root / MANIFEST_FILE).read_bytes()
    if shown:
        described = manifest.to_json().encode()
    rendered: dict[str, bytes | Path] = {CARD_FILE: text.encode(), MANIFEST_FILE: described, **shown}
    if (root / CROISSANT_FILE).exists():
        for_machines = (root / CROISSANT_FILE).read_text(encoding="utf-8")
        rendered[CROISSANT_FILE] = croissant_for_hub(for_machines, target.page, text, described).encode()
    return payload.with_rendered(rendered)


def run_upload(prepared: PreparedUpload) -> UploadResult:
    """Send what is missing, compare what arrived, and name it.

    What fails in passing is done once more, with what is then missing: nothing, where only the answer was
    lost. Raises HubError (what was sent stays there, and the same call goes on from it) or IntegrityError
    (what the Hub holds afterwards is not what the folder has).
    """
    target, now, tries = prepared.target, prepared, 0

    def send() -> tuple[str, str | None]:
        nonlocal now, tries
        tries += 1
        if tries > 1:
            now = now.at(target.state())
        if now.is_done and now.state.head is not None:
            return now.state.head, now.pull
        return target.send(now)

    # exist_ok: another upload may have made it since it was looked for.
    if not prepared.state.exists:
        target.do("create_repo", private=prepared.options.private, exist_ok=True)
    if not prepared.state.has_branch and target.branch != MAIN:
        target.do("create_branch", branch=target.branch, revision=prepared.state.head, exist_ok=True)
    commit, pull = ask(
        send, target.repo_id, target.branch, "uploading to", is_question=False, on_wait=target.on_wait
    )
    prepared.require_arrival(commit)
    tags = [tag for tag in prepared.tags if prepared.state.tags.get(tag) != commit]
    for tag in tags:
        target.set_tag(tag, commit, prepared.state.tags.get(tag))
    sent = () if prepared.is_done else tuple(file.path for file in prepared.plan.to_send)
    removed = () if prepared.is_done else prepared.removed
    return UploadResult(commit, pull, sent, removed, tuple(tags))
