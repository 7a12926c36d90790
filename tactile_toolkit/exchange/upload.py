"""Bringing a data set folder to the Hugging Face Hub.

First everything is compared and nothing is changed (:func:`prepare_upload`): is the folder intact, what has
the Hub already. Then what is missing is sent (:func:`run_upload`), and what arrived is compared by checksum.
"""

from __future__ import annotations

import contextlib
import warnings
import weakref
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property, partial
from pathlib import Path
from typing import Any, TypeVar

from tactile_toolkit.cards.card import CARD_FILE, PREVIEW_FOLDER, with_repo_name
from tactile_toolkit.cards.checks import check_card
from tactile_toolkit.cards.croissant import CROISSANT_FILE, croissant_again
from tactile_toolkit.cards.facts import configs, folder_facts, with_head
from tactile_toolkit.catalog.kinds import require_manifest
from tactile_toolkit.errors import InputError, IntegrityError
from tactile_toolkit.exchange.options import MAIN_BRANCH, UploadOptions
from tactile_toolkit.exchange.tables import viewer_tables
from tactile_toolkit.hub.calls import call_with_retry, page_of
from tactile_toolkit.hub.repository import HubName, HubSnapshot, hub_name, listing
from tactile_toolkit.kind import DatasetKind
from tactile_toolkit.run.threads import in_threads
from tactile_toolkit.store.files import scratch_folder
from tactile_toolkit.store.folder import DataFolder
from tactile_toolkit.store.manifest import MANIFEST_FILE, Manifest, read_manifest
from tactile_toolkit.store.names import names_inside, problem_of_name
from tactile_toolkit.store.origin import HubFile, has_digest
from tactile_toolkit.store.shards import VIEWER_FOLDER, Finding, ShardName
from tactile_toolkit.store.verify import problem_of_place, verify

# Written by the Hub itself; every repository has them.
_WRITTEN_BY_HUB = frozenset({".gitattributes"})
_PICTURE_FOLDER = "images"
_THREADS = 8

T = TypeVar("T")


@dataclass(frozen=True, slots=True)
class LocalFile:
    """A file to be sent: its path on the Hub, its local path, and its checksum where it is known."""

    path: str
    place: Path
    size: int
    sha256: str | None = None

    def has_content_of(self, remote: HubFile | None) -> bool:
        """Return whether a file of a repository has its content."""
        if remote is None or remote.digest is None or remote.size_bytes != self.size:
            return False
        if self.sha256 is not None and len(remote.digest) == len(self.sha256):
            return remote.digest == self.sha256
        return has_digest(self.place, remote.digest)


@dataclass(frozen=True, slots=True)
class UploadPlan:
    """The difference between a folder and a repository.

    Of what is not in the folder, but for what the Hub writes itself, some is ``kept``, the rest ``removed``.
    """

    to_send: tuple[LocalFile, ...]
    kept: tuple[str, ...]
    removed: tuple[str, ...]

    @property
    def is_done(self) -> bool:
        """Whether the repository holds the folder already, and nothing that is to go."""
        return not (self.to_send or self.removed)


def compare(files: Iterable[LocalFile], remote: Mapping[str, HubFile], *, delete: bool = False) -> UploadPlan:
    """Compare all that is to be in a repository with its files by path, by checksums.

    Of other files, those that former uploads made for the Hub's page go, and all others with ``delete``.
    """
    local = {file.path: file for file in files}
    missing = tuple(local[path] for path in sorted(local) if not local[path].has_content_of(remote.get(path)))
    kept, removed = _others(local, remote, delete=delete)
    return UploadPlan(missing, kept, removed)


def _others(
    local: Iterable[str], remote: Iterable[str], *, delete: bool
) -> tuple[tuple[str, ...], tuple[str, ...]]:
    """Return the files of a repository that a folder does not have: those kept, and those removed."""
    others = sorted(set(remote).difference(local, _WRITTEN_BY_HUB))
    gone = tuple(path for path in others if delete or _is_for_page(path))
    return tuple(path for path in others if not (delete or _is_for_page(path))), gone


def _is_for_page(path: str) -> bool:
    folder, _, name = path.rpartition("/")
    return folder == VIEWER_FOLDER and ShardName.parse(name) is not None


def collect(root: Path, manifest: Manifest) -> list[str]:
    """List the paths of a verified folder that are sent: files of the manifest, cards, pictures."""
    place, found = DataFolder(str(root)), [CARD_FILE, MANIFEST_FILE]
    found += [CROISSANT_FILE] if place.exists(CROISSANT_FILE) else []
    for folder in (PREVIEW_FOLDER, _PICTURE_FOLDER):
        paths = [path.relative_to(root).as_posix() for path in sorted((root / folder).rglob("*"))]
        # Names with a dot in front are of writers that have not finished; links may lead to anything.
        found += [path for path in paths if not problem_of_name(path) and not problem_of_place(place, path)]
    shards = (record.shard.data_path for record in manifest.shards)
    return list(dict.fromkeys([*found, *shards, *(manifest.files or ())]))


@dataclass(frozen=True)
class UploadTarget:
    """A branch of a data set repository as it is now, or a pull request.

    ``held`` is what the commit holds that the branch points to, or that it will start at, the head of
    ``main``; None where the repository does not exist. ``tags`` name commits. ``on_wait`` gets a sentence for
    each wait.
    """

    repo_id: str
    branch: str = MAIN_BRANCH
    on_wait: Callable[[str], None] = field(default=lambda _: None, repr=False, compare=False)
    held: HubSnapshot | None = None
    tags: Mapping[str, str] = field(default_factory=dict)
    has_branch: bool = False

    @property
    def page(self) -> str:
        """Address of the repository for people."""
        return page_of(self.repo_id)

    @property
    def files(self) -> Mapping[str, HubFile]:
        """What the branch holds, by path."""
        return self.held.files if self.held else {}

    def ask(self, action: Callable[[Any], T], **options: Any) -> T:
        """Return what an action does with the Hub's client; one that may be called once more."""
        from huggingface_hub import HfApi

        call = call_with_retry
        return call(lambda: action(HfApi()), self.repo_id, "uploading to", on_wait=self.on_wait, **options)

    def do(self, what: str, **options: Any) -> None:
        """Call a method of the client for this repository."""
        self.ask(lambda api: getattr(api, what)(self.repo_id, repo_type="dataset", **options))

    def now(self) -> UploadTarget:
        """Look what the branch holds; a repository or branch that does not exist is not an error."""
        from huggingface_hub import errors

        def look(api: Any) -> UploadTarget:
            try:
                refs = api.list_repo_refs(self.repo_id, repo_type="dataset")
            except errors.RepositoryNotFoundError as error:
                # To the client it is a kind of that, but such a repository exists.
                if isinstance(error, errors.GatedRepoError):
                    raise
                return replace(self, held=None)
            tags = {ref.name: str(ref.target_commit) for ref in refs.tags}
            # A pull request that is written to is not listed.
            is_there = self.branch.startswith("refs/") or self.branch in {ref.name for ref in refs.branches}
            held = listing(self.repo_id, self.branch if is_there else MAIN_BRANCH)
            return replace(self, held=held, tags=tags, has_branch=is_there)

        return self.ask(look)


@dataclass(frozen=True)
class PreparedUpload:
    """An upload that has been planned but not begun.

    ``left_out`` lies in the folder and does not belong to the data set. ``scratch`` holds what was made for
    the upload as long as this is kept.
    """

    target: UploadTarget
    options: UploadOptions
    manifest: Manifest
    files: tuple[LocalFile, ...]
    left_out: tuple[str, ...]
    scratch: Path

    @cached_property
    def plan(self) -> UploadPlan:
        """What is missing on the Hub, and what it has next to the folder's files."""
        return self.compared(self.target.held)

    def compared(self, held: HubSnapshot | None) -> UploadPlan:
        """Compare the folder with what a commit holds."""
        return compare(self.files, held.files if held else {}, delete=self.options.delete)

    @property
    def tags(self) -> tuple[str, ...]:
        """Names that the commit gets: the schema version's on the main branch, and the user's."""
        # What is not merged yet may never be.
        is_main = self.target.branch == MAIN_BRANCH and not self.options.create_pr
        schema = [f"schema-{self.manifest.schema_version}"] if is_main else []
        return tuple(dict.fromkeys([*schema, *([self.options.tag] if self.options.tag else [])]))


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
    that cannot be used), IntegrityError (damage, a card that does not fit the data) or HubError.
    """
    chosen, place = options or UploadOptions(), DataFolder(folder)
    manifest, target = read_manifest(place), UploadTarget(repo_id, chosen.revision or MAIN_BRANCH, on_wait)
    if hub_name(repo_id) != HubName(repo_id, None, ""):
        raise InputError(f"{repo_id!r} is not a name of a repository", next="give USER/NAME")
    if manifest is None:
        raise InputError(
            f"{place.missing_message(MANIFEST_FILE)}: only data sets made by this toolkit can be checked "
            "before they are sent",
            next="give the folder of one",
        )
    with contextlib.ExitStack() as stack:
        scratch = stack.enter_context(scratch_folder())
        if not place.is_local:
            place = local_copy(place, scratch / "copy")
        _require_sound(check(place) if check else verify(place, check_card=check_card).findings)
        if not dry_run:
            target.ask(lambda api: api.whoami())
        target = target.now()
        manifest, files = _files_to_send(place, manifest, target, chosen, scratch)
        left_out = tuple(sorted(set(place.names()).difference(file.path.partition("/")[0] for file in files)))
        prepared = PreparedUpload(target, chosen, manifest, files, left_out, scratch)
        _refuse_conflicts(prepared)
        weakref.finalize(prepared, stack.pop_all().close)
    return prepared


def local_copy(folder: DataFolder, root: Path) -> DataFolder:
    """Copy all files of a folder but hidden ones to this machine.

    Raises IntegrityError for names that lead out of a folder, StorageError where the disk is full, and
    RemoteError where the store fails.
    """
    visible = [path for path in folder.walk() if not path.startswith(".") and "/." not in path]
    paths = names_inside(visible, repr(folder.address()))
    for _ in in_threads(lambda path: folder.download(path, root / path), paths, _THREADS):
        pass
    return DataFolder(str(root))


def _require_sound(findings: Iterable[Finding]) -> None:
    found = [IntegrityError(f"{each.file} {each.problem}").what for each in findings]
    if found:
        more = f" and {len(found) - 3} more" if len(found) > 3 else ""
        raise IntegrityError(
            f"the folder is not fit to be sent, nothing was: {'; '.join(found[:3])}{more}",
            next="run the command that made it again, or the command `card` where only the card is wrong",
        )


def _refuse_conflicts(prepared: PreparedUpload) -> None:
    """Refuse to show what is to be private, and to move a tag of the user's."""
    options, target = prepared.options, prepared.target
    held, tag = target.held, options.tag or ""
    if options.private and held is not None and not held.is_private:
        raise InputError(
            f"{target.repo_id!r} exists and everyone can see it, --private was asked for; nothing was sent",
            next=f"make it private at {target.page}/settings, or leave --private out",
        )
    if tag in target.tags and not (prepared.plan.is_done and held and held.commit == target.tags[tag]):
        raise InputError(
            f"tag {tag!r} of {target.repo_id!r} names commit {target.tags[tag][:12]} already; nothing was "
            "sent",
            next="choose another --tag, or delete that one on the Hub",
        )


def _files_to_send(
    place: DataFolder, manifest: Manifest, target: UploadTarget, options: UploadOptions, scratch: Path
) -> tuple[Manifest, tuple[LocalFile, ...]]:
    """Collect the files, with the cards as they are to be on the Hub, checked as such."""
    root, described, made = Path(place.address()), place.read_bytes(MANIFEST_FILE), dict[str, str]()
    if options.viewer:
        made = viewer_tables(place, manifest, scratch)
        manifest = replace(manifest, files={**(manifest.files or {}), **made})
        described = manifest.to_json().encode()
    paths, facts = collect(root, manifest), folder_facts(place, manifest)
    others, _ = _others(paths, target.files, delete=options.delete)
    # Where the pattern of a split would take one of the others for its own, its files are named one by one.
    wanted = configs(facts, others)
    stored = with_repo_name(place.read_bytes(CARD_FILE).decode(), target.repo_id)
    text = with_head(stored, lambda head: head.update(configs=wanted))
    _require_sound(check_card(place, text, held={*paths, *others}, manifest=manifest))
    rendered = {CARD_FILE: text.encode(), MANIFEST_FILE: described}
    if CROISSANT_FILE in paths:
        stored = place.read_bytes(CROISSANT_FILE).decode()
        described_again = croissant_again(stored, facts, target.page, others)
        rendered[CROISSANT_FILE] = described_again.encode()
    for path, content in rendered.items():
        (scratch / path).write_bytes(content)
    known = {record.shard.data_path: record.sha256 for record in manifest.shards}
    known |= manifest.files or {}
    places = {path: (scratch if path in made or path in rendered else root) / path for path in paths}
    return manifest, tuple(
        LocalFile(path, where, where.stat().st_size, known.get(path)) for path, where in places.items()
    )


def run_upload(prepared: PreparedUpload) -> UploadResult:
    """Send what is missing, compare what arrived, and name it.

    What fails for the moment is done once more, with what is then missing: nothing, where only the answer was
    lost. Raises HubError (what was sent stays on the Hub, and the same call continues from it) or
    IntegrityError (what the Hub holds afterwards is not what the folder has).
    """
    target, options = prepared.target, prepared.options
    if target.held is None:
        # exist_ok: another upload may have made it since it was looked for.
        target.do("create_repo", private=options.private, exist_ok=True)
    if not target.has_branch and target.branch != MAIN_BRANCH:
        start = target.held.commit if target.held else None
        target.do("create_branch", branch=target.branch, revision=start, exist_ok=True)
    # A second try would open a second pull request where only the answer to the first was lost.
    commit, pull = target.ask(
        lambda api: _send(api, prepared), **({"waits_s": ()} if options.create_pr else {})
    )
    _require_arrival(prepared, commit)
    tags = tuple(tag for tag in prepared.tags if target.tags.get(tag) != commit)
    for tag in tags:
        if tag in target.tags:
            target.ask(partial(_delete_tag, repo_id=target.repo_id, tag=tag))  # the client moves no tag
        target.do("create_tag", tag=tag, revision=commit, exist_ok=True)
    sent = tuple(file.path for file in prepared.plan.to_send)
    return UploadResult(commit, pull, sent, prepared.plan.removed, tags)


def _send(api: Any, prepared: PreparedUpload) -> tuple[str, str | None]:
    """Send what is missing by now as one commit; return that, and the pull request that it opened."""
    from huggingface_hub import CommitOperationAdd, CommitOperationDelete

    target, options, manifest = prepared.target.now(), prepared.options, prepared.manifest
    plan = prepared.compared(target.held)
    if plan.is_done and target.held is not None:
        return target.held.commit, None
    message = f"Upload {manifest.kind} made by tactile-toolkit {manifest.toolkit_version}"
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # the client library's own, which no user can heed
        made = api.create_commit(
            repo_id=target.repo_id,
            operations=[
                *(CommitOperationDelete(path) for path in plan.removed),
                *(CommitOperationAdd(each.path, each.place) for each in plan.to_send),
            ],
            repo_type="dataset",
            commit_message=options.message or message,
            revision=None if options.create_pr else target.branch,
            create_pr=options.create_pr,
        )
    return str(made.oid), made.pr_revision


def _require_arrival(prepared: PreparedUpload, commit: str) -> None:
    """Compare every file of a commit with the folder, by checksum; IntegrityError names what differs."""
    target = prepared.target
    arrived = prepared.compared(target.ask(lambda _: listing(target.repo_id, commit)))
    wrong = [f"{each.path} differs or is missing" for each in arrived.to_send]
    wrong += [f"{path} is still there" for path in arrived.removed]
    if wrong:
        raise IntegrityError(
            f"{target.repo_id!r} does not hold what was sent (commit {commit[:12]}): "
            f"{'; '.join(wrong[:3])} ({len(wrong)} such files)",
            next="run the same upload again, it sends what is missing",
        )


def _delete_tag(api: Any, repo_id: str, tag: str) -> None:
    """Delete a tag; one that is gone, as where an answer was lost, is not a failure."""
    from huggingface_hub.errors import RevisionNotFoundError

    with contextlib.suppress(RevisionNotFoundError):
        api.delete_tag(repo_id, repo_type="dataset", tag=tag)
