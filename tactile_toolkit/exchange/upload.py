"""Bringing a data set folder to the Hugging Face Hub.

First everything is looked at and nothing is changed (:func:`prepare_upload`): is the folder whole, what has
the Hub already. Then what is missing is sent (:func:`run_upload`), and what arrived is compared by checksum.
"""

from __future__ import annotations

import warnings
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
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
    RemoteFile,
    UploadOptions,
    UploadPlan,
    card_for_hub,
    collect,
    compare,
)
from tactile_toolkit.exchange.viewer import ViewerFiles
from tactile_toolkit.hub.errors import require_repository_name
from tactile_toolkit.hub.retry import ask
from tactile_toolkit.kind import DatasetKind
from tactile_toolkit.store.folder import DataFolder
from tactile_toolkit.store.manifest import MANIFEST_FILE, Manifest, read_manifest
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
    """Where a commit went: its id, and the pull request it opened, such as ``"refs/pr/3"``."""

    commit: str
    pull: str | None = None


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

    def files_at(self, revision: str) -> dict[str, RemoteFile]:
        """List the files of a commit, tag, branch or pull request."""
        return self._ask(lambda: self._tree(revision))

    def open_pulls(self, author: str) -> list[str]:
        """List the newest open pull requests of an account, such as ``refs/pr/3``; newest first."""

        def pulls() -> list[int]:
            found = self._api().get_repo_discussions(
                self.repo_id,
                repo_type=_REPO_TYPE,
                author=author,
                discussion_type="pull_request",
                discussion_status="open",
            )
            return sorted((entry.num for entry in found), reverse=True)

        return [f"refs/pr/{number}" for number in self._ask(pulls)[:_PULLS_SEEN]]

    def commit_of(self, revision: str) -> str:
        """Return the commit that a branch or pull request points to."""
        return self._ask(
            lambda: str(self._api().repo_info(self.repo_id, repo_type=_REPO_TYPE, revision=revision).sha)
        )

    def create(self, *, private: bool) -> None:
        """Create the repository; one that is there already stays as it is."""
        api = self._api()
        self._ask(lambda: api.create_repo(self.repo_id, repo_type=_REPO_TYPE, private=private, exist_ok=True))

    def create_branch(self, start: str | None) -> None:
        """Create the branch at a commit, or at the head of ``main``; one that is there stays as it is."""
        api = self._api()
        self._ask(
            lambda: api.create_branch(
                self.repo_id, branch=self.branch, revision=start, repo_type=_REPO_TYPE, exist_ok=True
            )
        )

    def send(
        self,
        files: Mapping[str, bytes | Path],
        message: str,
        *,
        delete: Iterable[str],
        parent: str | None,
        pull: bool,
    ) -> Sent:
        """Send files as one commit, once: a lost answer is looked into, not repeated, by the caller.

        ``parent`` is the commit that the branch must still point to.
        """
        from huggingface_hub import CommitOperationAdd, CommitOperationDelete

        added = [CommitOperationAdd(path, content) for path, content in files.items()]
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # the client library's own, which no user can heed
            made = self._api().create_commit(
                repo_id=self.repo_id,
                operations=[*(CommitOperationDelete(path) for path in delete), *added],
                repo_type=_REPO_TYPE,
                commit_message=message,
                # The Hub opens pull requests against main itself, from wherever that is; only a branch may
                # have moved on.
                revision=None if pull else self.branch,
                create_pr=pull,
                parent_commit=None if pull else parent,
            )
        return Sent(made.oid, made.pr_revision)

    def set_tag(self, name: str, commit: str, there: str | None) -> None:
        """Make a tag name a commit; one that names another is moved."""
        api = self._api()
        if there is not None:
            # The client moves no tag.
            self._ask(lambda: api.delete_tag(self.repo_id, tag=name, repo_type=_REPO_TYPE))
        self._ask(
            lambda: api.create_tag(
                self.repo_id, tag=name, revision=commit, repo_type=_REPO_TYPE, exist_ok=True
            )
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
            private = bool(api.repo_info(self.repo_id, repo_type=_REPO_TYPE).private)
        # To the client it is a kind of RepositoryNotFoundError, but such a repository is there.
        except errors.GatedRepoError:
            raise
        except errors.RepositoryNotFoundError:
            return RemoteState(exists=False)
        refs = api.list_repo_refs(self.repo_id, repo_type=_REPO_TYPE)
        tags = {ref.name: str(ref.target_commit) for ref in refs.tags}
        heads = {ref.name: str(ref.target_commit) for ref in refs.branches}
        there = heads.get(self.branch)
        if there is None and self.branch.startswith("refs/"):  # a pull request that is written to
            there = str(api.repo_info(self.repo_id, repo_type=_REPO_TYPE, revision=self.branch).sha)
        head = there or heads.get(MAIN)
        files = self._tree(head) if head is not None else {}
        return RemoteState(True, private, head, files, tags, frozenset(heads), there is not None)

    def _tree(self, revision: str) -> dict[str, RemoteFile]:
        from huggingface_hub.hf_api import RepoFile

        entries = self._api().list_repo_tree(
            self.repo_id, recursive=True, revision=revision, repo_type=_REPO_TYPE
        )
        return {
            entry.path: RemoteFile(
                entry.path, entry.size, entry.blob_id, entry.lfs.sha256 if entry.lfs is not None else None
            )
            for entry in entries
            if isinstance(entry, RepoFile)
        }


@dataclass(frozen=True)
class PreparedUpload:
    """An upload that is decided and not begun; ``pull`` is an open pull request that holds everything.

    ``copy`` and ``viewer`` are kept as long as this is: the copy on this machine of a folder in an object
    store, and the files that were made for the Hub's page.
    """

    target: UploadTarget
    options: UploadOptions
    manifest: Manifest
    payload: Payload
    state: RemoteState
    plan: UploadPlan
    pull: str | None = None
    copy: LocalCopy | None = None
    viewer: ViewerFiles | None = None

    @property
    def is_done(self) -> bool:
        """Whether nothing is to be sent or removed."""
        return self.pull is not None or self.plan.is_done(delete=self.options.delete)

    @property
    def removed(self) -> tuple[str, ...]:
        """Files of the repository that are to be removed."""
        return tuple(file.path for file in self.plan.to_remove(delete=self.options.delete))

    @property
    def kept(self) -> tuple[str, ...]:
        """Files of the repository that the folder lacks and that stay."""
        removed = set(self.removed)
        return tuple(file.path for file in self.plan.remote_only if file.path not in removed)

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
    plan = compare(payload.files, state.files)
    prepared = PreparedUpload(target, chosen, manifest, payload, state, plan, copy=copy, viewer=viewer)
    _refuse_other_tag(prepared)
    if chosen.create_pr and state.exists and name and not prepared.is_done:
        return replace(prepared, pull=_holding_pull(prepared, name))
    return prepared


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
    there = compare(payload.files, state.files)
    replaced = {file.path for file in there.to_remove(delete=options.delete)}
    staying = [file for file in there.remote_only if file.path not in replaced]
    stored = (root / CARD_FILE).read_text(encoding="utf-8")
    shards = {split: [r.shard.data_path for r in manifest.shards_of(split)] for split in manifest.splits}
    others = [file.path for file in staying]
    text = card_for_hub(stored, target.repo_id, shards, others, viewer_files(manifest))
    held = {*(file.path for file in payload.files), *(file.path for file in staying)}
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

    A commit whose answer was lost is looked for before it is tried again, so that none is made twice. Raises
    HubError (what was sent stays there, and the same call goes on from it) or IntegrityError (what the Hub
    holds afterwards is not what the folder has).
    """
    sent, did_send = _ensure_sent(prepared)
    _require_arrival(prepared, sent)
    return UploadResult(
        sent.commit,
        sent.pull,
        tuple(file.path for file in prepared.plan.to_send) if did_send else (),
        prepared.removed if did_send else (),
        tuple(_tagged(prepared, sent)),
    )


def _ensure_sent(prepared: PreparedUpload) -> tuple[Sent, bool]:
    """Make the Hub hold the folder; tell where, and whether anything had to be sent for it."""
    target, options = prepared.target, prepared.options
    if prepared.pull is not None:
        return Sent(target.commit_of(prepared.pull), prepared.pull), False
    # exist_ok, here and below: another upload may have made it since it was looked for.
    if not prepared.state.exists:
        target.create(private=options.private)
    if not prepared.state.has_branch and target.branch != MAIN:
        target.create_branch(prepared.state.head)
    if prepared.is_done and prepared.state.head is not None:
        return Sent(prepared.state.head), False
    plan, head = prepared.plan, prepared.state.head

    def send() -> Sent:
        return target.send(
            {file.path: prepared.payload.content(file) for file in plan.to_send},
            prepared.message,
            delete=[file.path for file in plan.to_remove(delete=options.delete)],
            parent=head,
            pull=options.create_pr,
        )

    def find_commit() -> Sent | None:
        """Look whether it was made though its answer was lost; if not, what is still to send, and on what."""
        nonlocal plan, head
        if options.create_pr:
            pull = _holding_pull(prepared, target.who())
            return None if pull is None else Sent(target.commit_of(pull), pull)
        state = target.state()
        plan, head = compare(prepared.payload.files, state.files), state.head
        return Sent(head) if head is not None and plan.is_done(delete=options.delete) else None

    sent = ask(
        send,
        target.repo_id,
        target.branch,
        "uploading to",
        is_question=False,
        find_result=find_commit,
        on_wait=target.on_wait,
    )
    return sent, True


def _holding_pull(prepared: PreparedUpload, author: str) -> str | None:
    """Return an open pull request of ours that holds everything already."""
    for pull in prepared.target.open_pulls(author):
        plan = compare(prepared.payload.files, prepared.target.files_at(pull))
        if plan.is_done(delete=prepared.options.delete):
            return pull
    return None


def _require_arrival(prepared: PreparedUpload, sent: Sent) -> None:
    """Compare every file of the commit with the folder, by checksum; IntegrityError names what differs."""
    arrived = compare(prepared.payload.files, prepared.target.files_at(sent.commit))
    wrong = [
        *(f"{file.path} is missing" for file in arrived.new),
        *(f"{f.path} differs" for f in arrived.changed),
    ]
    still_there = arrived.to_remove(delete=prepared.options.delete)
    wrong += [f"{file.path} is still there" for file in still_there]
    if wrong:
        message = (
            f"{prepared.target.repo_id!r} does not hold what was sent (commit {sent.commit[:12]}): "
            f"{'; '.join(wrong[:3])} ({len(wrong)} such files); next: run the same upload again, it sends "
            "what is missing"
        )
        raise IntegrityError(message)


def _tagged(prepared: PreparedUpload, sent: Sent) -> Iterator[str]:
    """Set the names that do not name the commit yet, and yield them."""
    for tag in prepared.tags:
        there = prepared.state.tags.get(tag)
        if there != sent.commit:
            prepared.target.set_tag(tag, sent.commit, there)
            yield tag
