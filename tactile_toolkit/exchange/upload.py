"""Bringing a data set folder to the Hugging Face Hub.

First everything is looked at and nothing is changed (:func:`prepare_upload`): is the folder intact, what has
the Hub already. Then what is missing is sent (:func:`run_upload`), and what arrived is compared by checksum.
"""

from __future__ import annotations

import contextlib
import re
import warnings
import weakref
from collections.abc import Callable, Container, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from fnmatch import fnmatch
from functools import cached_property, partial
from pathlib import Path
from typing import Any, TypeVar

from tactile_toolkit.cards.card import CARD_FILE, PREVIEW_FOLDER, addressed
from tactile_toolkit.cards.checks import check_card
from tactile_toolkit.cards.croissant import CROISSANT_FILE, croissant_for_hub
from tactile_toolkit.cards.facts import viewer_files
from tactile_toolkit.cards.head import config_of, head_text
from tactile_toolkit.catalog.kinds import require_manifest
from tactile_toolkit.errors import InputError, IntegrityError
from tactile_toolkit.exchange.tables import viewer_tables
from tactile_toolkit.hub.calls import call_with_retry
from tactile_toolkit.hub.repository import HubName, HubSnapshot, hub_name, listing
from tactile_toolkit.kind import DatasetKind
from tactile_toolkit.run.threads import in_threads
from tactile_toolkit.store.files import scratch_folder
from tactile_toolkit.store.folder import DataFolder
from tactile_toolkit.store.manifest import MANIFEST_FILE, Manifest, read_manifest
from tactile_toolkit.store.names import names_inside, problem_of_name
from tactile_toolkit.store.origin import Digest, HubFile
from tactile_toolkit.store.shards import DATA_FOLDER, VIEWER_FOLDER, Finding, ShardName
from tactile_toolkit.store.verify import problem_of_place, verify

_MAIN = "main"
_COMMIT = re.compile(r"[0-9a-f]{40}")
# Written by the Hub itself; every repository has them.
_WRITTEN_BY_HUB = frozenset({".gitattributes"})
_PICTURE_FOLDER = "images"
_MOST_IN_GIT_BYTES = 10 << 20  # from here on the Hub keeps every file as a large one
_SHA256, _GIT = Digest("sha256", "0" * 64), Digest("git-sha1", "0" * 40)
_FENCE = "---\n"
_THREADS = 8
# All files of each are listed and compared.
_PULLS_SEEN = 10

T = TypeVar("T")


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
        Open a pull request against the main branch instead of writing to it.
    message : str or None
        First line of the commit.
    tag : str or None
        Name to give to the commit, next to that of the schema version; what is not merged yet gets none.
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
        branch, tag = f"--revision {self.revision}", f"--tag {self.tag}"
        exclude = "{} and {} exclude each other; next: leave one of them out"
        is_pull = (self.revision or "").startswith("refs/")
        _refuse(
            (self.create_pr and self.revision not in (None, _MAIN), exclude.format("--create-pr", branch)),
            (self.tag and self.create_pr, exclude.format("--create-pr", tag)),
            (self.tag and is_pull, exclude.format(branch, tag)),
            # Such names would be read as something else ever after.
            (
                _COMMIT.fullmatch(self.revision or ""),
                f"{branch} is the name of a commit; next: give a branch",
            ),
            (_COMMIT.fullmatch(self.tag or ""), f"{tag} is the name of a commit; next: choose another"),
            (self.tag == (self.revision or _MAIN), f"{tag} is the name of the branch; next: choose another"),
        )


def _refuse(*problems: tuple[object, str]) -> None:
    for is_found, message in problems:
        if is_found:
            raise InputError(message)


@dataclass(frozen=True, slots=True)
class LocalFile:
    """A file as it is to be on the Hub: its path there, where it lies, and the digests it may have there."""

    path: str
    place: Path
    size: int
    digests: tuple[Digest, ...]

    @classmethod
    def of(cls, path: str, place: Path, sha256: str | None = None) -> LocalFile:
        """Look at a file; its SHA-256 is computed unless it is known."""
        with place.open("rb") as stream:
            size = place.stat().st_size
            digests = [Digest("sha256", sha256) if sha256 else _SHA256.of_stream(stream, size)]
            if size <= _MOST_IN_GIT_BYTES:
                stream.seek(0)
                digests.append(_GIT.of_stream(stream, size))
        return cls(path, place, size, tuple(digests))

    def is_held(self, there: HubFile) -> bool:
        """Return whether a file of a repository has its content."""
        return self.size == there.size_bytes and there.digest in self.digests


@dataclass(frozen=True, slots=True)
class UploadPlan:
    """The difference between a folder and a repository.

    Of what the folder lacks, but for what the Hub writes itself, some files are ``kept``, others ``removed``.
    """

    to_send: tuple[LocalFile, ...]
    kept: tuple[str, ...]
    removed: tuple[str, ...]

    @property
    def is_done(self) -> bool:
        """Whether the repository holds the folder already, and nothing that is to go."""
        return not (self.to_send or self.removed)


def compare(files: Iterable[LocalFile], there: Mapping[str, HubFile], *, delete: bool = False) -> UploadPlan:
    """Compare all that is to be in a repository with its files by path, by checksums.

    Of other files, those that former uploads made for the Hub's page go, and all others with ``delete``.
    """
    local = {file.path: file for file in files}
    others = [path for path in sorted(there) if path not in local and path not in _WRITTEN_BY_HUB]
    missing = [
        local[path] for path in sorted(local) if path not in there or not local[path].is_held(there[path])
    ]
    kept = [path for path in others if not (delete or _is_for_page(path))]
    removed = [path for path in others if delete or _is_for_page(path)]
    return UploadPlan(tuple(missing), tuple(kept), tuple(removed))


def _is_for_page(path: str) -> bool:
    folder, _, name = path.rpartition("/")
    return folder == VIEWER_FOLDER and ShardName.parse(name) is not None


def collect(root: Path, manifest: Manifest, elsewhere: Container[str] = ()) -> list[LocalFile]:
    """List a verified folder's files: those of the manifest, the cards, the pictures.

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
    return [LocalFile.of(path, root / path, known.get(path)) for path in dict.fromkeys([*others, *known])]


def left_out(root: Path, sent: Iterable[str]) -> list[str]:
    """List the files and sub-folders of a folder of which nothing is sent."""
    names = {path.partition("/")[0] for path in sent}
    others = sorted(entry for entry in root.iterdir() if entry.name not in names)
    return [f"{entry.name}/" if entry.is_dir() else entry.name for entry in others]


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


@dataclass(frozen=True)
class UploadTarget:
    """A branch of a data set repository as it is now, or a pull request.

    ``held`` is what the commit holds that the branch points to, or that it will start at, the head of
    ``main``; None where there is no such repository. ``tags`` and ``branches`` name commits. ``on_wait`` gets
    a sentence for each wait.
    """

    repo_id: str
    branch: str = _MAIN
    on_wait: Callable[[str], None] = field(default=lambda _: None, repr=False, compare=False)
    held: HubSnapshot | None = None
    tags: Mapping[str, str] = field(default_factory=dict)
    branches: Mapping[str, str] = field(default_factory=dict)
    has_branch: bool = False

    @property
    def page(self) -> str:
        """Address of the repository for people."""
        from huggingface_hub import constants

        return f"{constants.ENDPOINT}/datasets/{self.repo_id}"

    @property
    def files(self) -> Mapping[str, HubFile]:
        """What the branch holds, by path."""
        return self.held.files if self.held else {}

    def ask(self, action: Callable[[Any], T], *, is_question: bool = True) -> T:
        """Return what an action does with the Hub's client; one that may be called once more."""
        from huggingface_hub import HfApi

        options: dict[str, Any] = {"is_question": is_question, "on_wait": self.on_wait}
        doing = "uploading to"
        return call_with_retry(lambda: action(HfApi()), self.repo_id, self.branch, doing, **options)

    def do(self, what: str, **options: Any) -> None:
        """Call a method of the client for this repository."""
        self.ask(lambda api: getattr(api, what)(self.repo_id, repo_type="dataset", **options))

    def at(self, revision: str) -> HubSnapshot:
        """List the files of a commit or pull request."""
        return self.ask(lambda _: listing(self.repo_id, revision, in_pages=True))

    def now(self) -> UploadTarget:
        """Look what the branch holds; a repository or branch that does not exist is not an error."""
        from huggingface_hub import errors

        def look(api: Any) -> UploadTarget:
            try:
                refs = api.list_repo_refs(self.repo_id, repo_type="dataset")
            except errors.RepositoryNotFoundError as error:
                # To the client it is a kind of that, but such a repository is there.
                if isinstance(error, errors.GatedRepoError):
                    raise
                return UploadTarget(self.repo_id, self.branch, self.on_wait)
            tags, heads = (
                {ref.name: str(ref.target_commit) for ref in kind} for kind in (refs.tags, refs.branches)
            )
            # A pull request that is written to is not listed.
            is_there = self.branch in heads or self.branch.startswith("refs/")
            held = listing(self.repo_id, self.branch if is_there else _MAIN, in_pages=True)
            return replace(self, held=held, tags=tags, branches=heads, has_branch=is_there)

        return self.ask(look)


@dataclass(frozen=True)
class PreparedUpload:
    """An upload that is decided and not begun; ``pull`` is an open pull request that holds everything.

    ``left_out`` lies in the folder and does not belong to the data set. ``scratch`` holds what was made for
    the upload as long as this is kept.
    """

    target: UploadTarget
    options: UploadOptions
    manifest: Manifest
    files: tuple[LocalFile, ...]
    left_out: tuple[str, ...]
    scratch: Scratch
    pull: str | None = None

    @cached_property
    def plan(self) -> UploadPlan:
        """What the Hub lacks of the folder, and has next to it."""
        return compare(self.files, self.target.files, delete=self.options.delete)

    def at(self, target: UploadTarget) -> PreparedUpload:
        """Return the upload that is left where the Hub holds that; or an open pull request holds all."""
        left = replace(self, target=target, pull=None)
        if not self.options.create_pr or target.held is None or left.plan.is_done:
            return left

        def open_pulls(api: Any) -> list[int]:
            wanted = {"discussion_type": "pull_request", "discussion_status": "open"}
            found = api.get_repo_discussions(target.repo_id, repo_type="dataset", **wanted)
            return sorted((each.num for each in found), reverse=True)[:_PULLS_SEEN]

        pulls = (f"refs/pr/{number}" for number in target.ask(open_pulls))
        others = (replace(left, target=replace(target, held=target.at(pull)), pull=pull) for pull in pulls)
        return next((other for other in others if other.plan.is_done), left)

    def send(self, api: Any) -> tuple[str, str | None]:
        """Send what is missing as one commit; return that, and the pull request that it opened."""
        from huggingface_hub import CommitOperationAdd, CommitOperationDelete

        pull, held = self.options.create_pr, self.target.held
        gone = [CommitOperationDelete(path) for path in self.plan.removed]
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # the client library's own, which no user can heed
            made = api.create_commit(
                repo_id=self.target.repo_id,
                operations=[
                    *gone,
                    *(CommitOperationAdd(each.path, each.place) for each in self.plan.to_send),
                ],
                repo_type="dataset",
                commit_message=self.message,
                # The Hub opens pull requests against main itself, from wherever that is; only a branch may
                # have moved on.
                revision=None if pull else self.target.branch,
                create_pr=pull,
                parent_commit=None if pull or held is None else held.commit,
            )
        return str(made.oid), made.pr_revision

    def require_arrival(self, commit: str) -> None:
        """Compare every file of a commit with the folder, by checksum; IntegrityError names what differs."""
        there = self.target.at(commit).files
        arrived = compare(self.files, there, delete=self.options.delete)
        wrong = [
            f"{each.path} {'differs' if each.path in there else 'is missing'}" for each in arrived.to_send
        ]
        wrong += [f"{path} is still there" for path in arrived.removed]
        if wrong:
            raise IntegrityError(
                f"{self.target.repo_id!r} does not hold what was sent (commit {commit[:12]}): "
                f"{'; '.join(wrong[:3])} ({len(wrong)} such files)",
                next="run the same upload again, it sends what is missing",
            )

    @property
    def mixed(self) -> tuple[str, ...]:
        """Files among those kept that are named like shards of the folder's splits, but are not."""
        shards = tuple(f"{DATA_FOLDER}/{split}-" for split in self.manifest.splits)
        return tuple(path for path in self.plan.kept if path.startswith(shards))

    @property
    def tags(self) -> tuple[str, ...]:
        """Names that the commit gets: the schema version's on the main branch, and the user's."""
        # What is not merged yet may never be.
        if self.options.create_pr or self.target.branch.startswith("refs/"):
            return ()
        schema = [f"schema-{self.manifest.schema_version}"] if self.target.branch == _MAIN else []
        return tuple(dict.fromkeys([*schema, *([self.options.tag] if self.options.tag else [])]))

    @property
    def message(self) -> str:
        """First line of the commit."""
        made = f"{self.manifest.kind} made by tactile-toolkit {self.manifest.toolkit_version}"
        return self.options.message or f"Upload {made}"


class Scratch:
    """A folder for what is made on the way, which goes with this object."""

    def __init__(self) -> None:
        stack = contextlib.ExitStack()
        self.place = stack.enter_context(scratch_folder())
        # Not a TemporaryDirectory, which warns of every object that is not closed.
        self._removal = weakref.finalize(self, stack.close)


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
    chosen, place, scratch = options or UploadOptions(), DataFolder(folder), Scratch()
    manifest, target = read_manifest(place), UploadTarget(repo_id, chosen.revision or _MAIN, on_wait)
    is_name = hub_name(repo_id) == HubName(repo_id, None, "")
    _refuse((not is_name, f"{repo_id!r} is not a name of a repository; next: give USER/NAME"))
    if manifest is None:
        raise InputError(
            f"{place.lacks(MANIFEST_FILE)}: only data sets made by this toolkit can be checked before they "
            "are sent",
            next="give the folder of one",
        )
    if not place.is_local:
        place = local_copy(place, scratch.place / "copy")
    _require_sound(check(place) if check else verify(place, check_card=check_card).findings)
    if not dry_run:
        target.ask(lambda api: api.whoami())
    target = target.now()
    manifest, files = _files_to_send(place, manifest, target, chosen, scratch.place)
    unsent = left_out(Path(place.address()), (file.path for file in files))
    prepared = PreparedUpload(target, chosen, manifest, files, tuple(unsent), scratch).at(target)
    _refuse_conflicts(prepared)
    return prepared


def local_copy(folder: DataFolder, root: Path) -> DataFolder:
    """Copy all files of a folder but hidden ones to this machine.

    Raises IntegrityError for names that lead out of a folder, StorageError where there is no room, and
    RemoteError where the store fails.
    """
    visible = [path for path in folder.walk() if not path.startswith(".") and "/." not in path]
    paths = names_inside(visible, repr(folder.address()))
    for _ in in_threads(lambda path: folder.copy_out(path, root / path), paths, _THREADS):
        pass
    return DataFolder(str(root))


def _require_sound(findings: Iterable[Finding]) -> None:
    found = [f"{each.file} {each.problem}".partition("; next: ")[0] for each in findings]
    if found:
        more = f" and {len(found) - 3} more" if len(found) > 3 else ""
        raise IntegrityError(
            f"the folder is not fit to be sent, nothing was: {'; '.join(found[:3])}{more}",
            next="run the command that made it again, or the command `card` where only the card is wrong",
        )


def _refuse_conflicts(prepared: PreparedUpload) -> None:
    """Refuse to show what is to be private, to mix up tags and branches, and to move a tag of the user's."""
    options, target, unsent = prepared.options, prepared.target, "nothing was sent; next:"
    of_it, other = f"of {target.repo_id!r}", "choose another name"
    is_public = target.held is not None and not target.held.is_private
    names = target.tags.get(options.tag or "", "")
    is_new = not prepared.plan.is_done or target.held is None or target.held.commit != names
    _refuse(
        (
            options.private and is_public,
            f"{target.repo_id!r} exists and everyone can see it, --private was asked for; {unsent} make it "
            f"private at {target.page}/settings, or leave --private out",
        ),
        (
            options.revision in target.tags and not target.has_branch,
            f"--revision {options.revision}: {of_it} that is a tag; {unsent} {other}",
        ),
        (options.tag in target.branches, f"--tag {options.tag}: {of_it} that is a branch; {unsent} {other}"),
        (
            names and is_new,
            f"tag {options.tag!r} {of_it} names commit {names[:12]} already; {unsent} choose another --tag, "
            "or delete that one on the Hub",
        ),
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
    files = collect(root, manifest, made)
    others = compare(files, target.files, delete=options.delete).kept
    shards = {split: [r.shard.data_path for r in manifest.shards_of(split)] for split in manifest.splits}
    stored = place.read_bytes(CARD_FILE).decode()
    text = card_for_hub(stored, target.repo_id, shards, others, viewer_files(manifest))
    held = {*(file.path for file in files), *made, *others}
    _require_sound(check_card(place, text, held=held, manifest=manifest))
    rendered = {CARD_FILE: text.encode(), MANIFEST_FILE: described}
    if place.exists(CROISSANT_FILE):
        for_machines = place.read_bytes(CROISSANT_FILE).decode()
        rendered[CROISSANT_FILE] = croissant_for_hub(for_machines, target.page, text, described).encode()
    for path, content in rendered.items():
        (scratch / path).write_bytes(content)
    as_they_are = [file for file in files if file.path not in rendered]
    return manifest, (*(LocalFile.of(path, scratch / path) for path in (*rendered, *made)), *as_they_are)


def _delete_tag(api: Any, repo_id: str, tag: str) -> None:
    """Delete a tag; one that is gone, as where an answer was lost, is not a failure."""
    from huggingface_hub.errors import RevisionNotFoundError

    with contextlib.suppress(RevisionNotFoundError):
        api.delete_tag(repo_id, repo_type="dataset", tag=tag)


def run_upload(prepared: PreparedUpload) -> UploadResult:
    """Send what is missing, compare what arrived, and name it.

    What fails for the moment is done once more, with what is then missing: nothing, where only the answer was
    lost. Raises HubError (what was sent stays there, and the same call continues from it) or IntegrityError
    (what the Hub holds afterwards is not what the folder has).
    """
    target, now, tries = prepared.target, prepared, 0
    if target.held is None:
        # exist_ok: another upload may have made it since it was looked for.
        target.do("create_repo", private=prepared.options.private, exist_ok=True)
    if not target.has_branch and target.branch != _MAIN:
        start = target.held.commit if target.held else None
        target.do("create_branch", branch=target.branch, revision=start, exist_ok=True)

    def send(api: Any) -> tuple[str, str | None]:
        nonlocal now, tries
        tries += 1
        if tries > 1:
            now = now.at(target.now())
        held = now.target.held
        return (held.commit, now.pull) if held is not None and now.plan.is_done else now.send(api)

    commit, pull = target.ask(send, is_question=False)
    prepared.require_arrival(commit)
    tags = [tag for tag in prepared.tags if target.tags.get(tag) != commit]
    for tag in tags:
        if tag in target.tags:
            target.ask(partial(_delete_tag, repo_id=target.repo_id, tag=tag))  # the client moves no tag
        target.do("create_tag", tag=tag, revision=commit, exist_ok=True)
    sent = tuple(file.path for file in prepared.plan.to_send)
    return UploadResult(commit, pull, sent, prepared.plan.removed, tuple(tags))
