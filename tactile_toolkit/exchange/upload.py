"""Uploading a data set folder to the Hugging Face Hub.

:meth:`Upload.of_folder` checks the folder and compares it with the repository, and changes nothing.
:meth:`Upload.send` sends the missing files, and compares the checksums of the result.
"""

from __future__ import annotations

import contextlib
import warnings
import weakref
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path
from typing import Any, TypeAlias

from tactile_toolkit import cards, hub, run, store, wording
from tactile_toolkit.cards import yaml_head
from tactile_toolkit.cards.card import PREVIEW_FOLDER, with_repo_name
from tactile_toolkit.errors import HubError, InputError, IntegrityError
from tactile_toolkit.exchange.upload_options import MAIN_BRANCH, UploadOptions
from tactile_toolkit.hub.calls import call_with_retry, page_of
from tactile_toolkit.hub.repository import HubName, listing
from tactile_toolkit.kind import DatasetKind
from tactile_toolkit.places.opening import folder_place
from tactile_toolkit.store.files import scratch_folder
from tactile_toolkit.store.manifest import VIEWER_FOLDER
from tactile_toolkit.store.remote import FsspecFolder
from tactile_toolkit.store.verification import HubFile, has_digest
from tactile_toolkit.value_types import JsonDict

# Written by the Hub itself; every repository has them.
_WRITTEN_BY_HUB = frozenset({".gitattributes"})
_PICTURE_FOLDER = "images"
_THREADS = 8
# Calls the Hub, again while it is busy, and returns the answer.
_Ask: TypeAlias = Callable[..., Any]
_State: TypeAlias = "tuple[hub.HubRepository | None, dict[str, str], bool]"


@dataclass(frozen=True, slots=True)
class LocalFile:
    """A file to send: its path on the Hub, its local path, and its checksum if it is known."""

    path: str
    local_path: Path
    size: int
    sha256: str | None = None

    def has_content_of(self, remote: HubFile | None) -> bool:
        """Return whether a file of a repository has the same content."""
        if remote is None or remote.digest is None or remote.size_bytes != self.size:
            return False
        if self.sha256 is not None and len(remote.digest) == len(self.sha256):
            return remote.digest == self.sha256
        return has_digest(self.local_path, remote.digest)


@dataclass(frozen=True, slots=True)
class UploadPlan:
    """The difference between a folder and a branch.

    Files of the branch that are not in the folder are ``kept`` or ``removed``.
    """

    to_send: tuple[LocalFile, ...]
    kept: tuple[str, ...]
    removed: tuple[str, ...]

    @property
    def is_done(self) -> bool:
        """Whether the branch already holds the folder and no file is to be removed."""
        return not (self.to_send or self.removed)


def compare(
    files: Iterable[LocalFile], held: hub.HubRepository | None, *, delete: bool = False
) -> UploadPlan:
    """Compare the files for a repository with those of a commit, by path and checksum."""
    local = {file.path: file for file in files}
    remote = {} if held is None else held.remote
    missing = tuple(local[path] for path in sorted(local) if not local[path].has_content_of(remote.get(path)))
    return UploadPlan(missing, *_other_files(local, remote, delete))


def _other_files(
    paths: Iterable[str], remote: Iterable[str], delete: bool
) -> tuple[tuple[str, ...], tuple[str, ...]]:
    """Return the other files of a commit that stay, and those that are removed.

    Files that former uploads made for the viewer of the Hub are removed, and with ``delete`` all others, too.
    """
    others = sorted(set(remote) - set(paths) - _WRITTEN_BY_HUB)
    removed = tuple(path for path in others if delete or _is_for_page(path))
    return tuple(path for path in others if path not in removed), removed


def _is_for_page(path: str) -> bool:
    folder, _, name = path.rpartition("/")
    return folder == VIEWER_FOLDER and store.ShardName.parse(name) is not None


def collect(root: Path, manifest: store.Manifest) -> list[str]:
    """List the files of a verified folder that are sent: files of the manifest, card, pictures."""
    data_folder = store.open_folder(str(root))
    sent = [store.CARD_FILE, store.MANIFEST_FILE]
    for folder in (PREVIEW_FOLDER, _PICTURE_FOLDER):
        paths = [path.relative_to(root).as_posix() for path in sorted((root / folder).rglob("*"))]
        # Names with a leading dot are unfinished files; links may lead to any file.
        sent += [
            path
            for path in paths
            if not store.problem_of_name(path) and not data_folder.problem_of_file(path)
        ]
    shards = (record.shard.data_path for record in manifest.shards)
    return list(dict.fromkeys([*sent, *shards, *(manifest.files or ())]))


@dataclass(frozen=True)
class Upload:
    """Files for a repository, and how they differ from what it holds.

    ``held`` is the head of the branch, or of ``main``, where a new branch starts; None without a repository.
    ``has_branch`` states whether the branch exists, ``plan`` is the difference. Files that were made for
    the upload stay as long as the planned upload lives; :meth:`send` returns a copy of that, which does not
    keep them. ``ask`` calls a function that uses the Hub, with retries. ``left_out`` are files of
    the folder that do not belong to the data set. ``unasked`` states why a dry run could not reach the Hub.
    ``commit`` holds the files after :meth:`send`, and ``pull`` is its pull request, if it is not on a branch.
    """

    repo_id: str
    options: UploadOptions
    held: hub.HubRepository | None
    has_branch: bool
    files: tuple[LocalFile, ...]
    plan: UploadPlan
    ask: _Ask = field(repr=False)
    what: str
    manifest: store.Manifest | None = None
    left_out: tuple[str, ...] = ()
    unasked: str = ""
    commit: str | None = None
    pull: str | None = None

    @classmethod
    def of_folder(
        cls,
        folder: str,
        repo_id: str,
        options: UploadOptions | None = None,
        *,
        kind: DatasetKind | None = None,
        workers: int = 1,
        dry_run: bool = False,
        on_wait: Callable[[str], None] = lambda _: None,
    ) -> Upload:
        """Verify a folder, render its card, and compare it with the repository; changes nothing.

        With ``kind`` its rows are checked, too, by a number of ``workers``. A dry run needs neither an
        account nor a network: if the Hub cannot be reached, it plans to send all files. Raises InputError
        (not a finished data set, an unusable option), IntegrityError (damage, a card that does not match the
        data) or HubError.
        """
        chosen = options or UploadOptions()
        data_folder = store.open_folder(folder)
        manifest = store.read_manifest(data_folder)
        ask = _asking(repo_id, on_wait)
        if manifest is None:
            message = data_folder.missing_message(store.MANIFEST_FILE)
            raise InputError(message, next="give the folder of a data set made by this toolkit")
        with contextlib.ExitStack() as stack:
            scratch = stack.enter_context(scratch_folder())
            if isinstance(data_folder, FsspecFolder):
                data_folder = local_copy(data_folder, scratch / "copy")
            _require_sound(check_folder(data_folder, kind, workers))
            state, unasked = _asked_state(ask, repo_id, chosen.branch, dry_run=dry_run)
            manifest, files = _files_to_send(data_folder, manifest, repo_id, state[0], chosen, scratch)
            sent = {file.path.partition("/")[0] for file in files}
            what = f"{manifest.kind} made by tactile-toolkit {manifest.toolkit_version}"
            upload = replace(
                _compared(repo_id, chosen, state, files, ask, what),
                manifest=manifest,
                left_out=tuple(sorted(set(data_folder.names()) - sent)),
                unasked=unasked,
            )
            weakref.finalize(upload, stack.pop_all().close)
        return upload

    @classmethod
    def of_files(
        cls,
        files: Mapping[str, bytes],
        card: str,
        repo_id: str,
        options: UploadOptions,
        *,
        what: str,
        dry_run: bool = False,
        on_wait: Callable[[str], None] = lambda _: None,
    ) -> Upload:
        """Compare a few files that are no data set, by path, with a repository; changes nothing.

        ``card`` is the text of the page of the repository, ``what`` names the files in the commit. Raises
        InputError (an unusable option) or HubError.
        """
        ask = _asking(repo_id, on_wait)
        with contextlib.ExitStack() as stack:
            scratch = stack.enter_context(scratch_folder())
            sent = {**files, store.CARD_FILE: card.encode()}
            for path, content in sent.items():
                (scratch / path).write_bytes(content)
            state, unasked = _asked_state(ask, repo_id, options.branch, dry_run=dry_run)
            local = tuple(LocalFile(path, scratch / path, len(content)) for path, content in sent.items())
            compared = _compared(repo_id, options, state, local, ask, what)
            upload = replace(compared, unasked=unasked)
            weakref.finalize(upload, stack.pop_all().close)
        return upload

    @property
    def page(self) -> str:
        """Address of the web page of the repository."""
        return page_of(self.repo_id)

    @property
    def where(self) -> str:
        """The repository, and its branch unless this is the main one."""
        if self.options.is_main:
            return self.repo_id
        return f"{self.repo_id} ({self.options.branch})"

    @property
    def revision(self) -> str | None:
        """The revision that holds the files; None for the main branch."""
        if self.pull or self.options.is_main:
            return self.pull
        return self.options.branch

    @property
    def address(self) -> str:
        """Address of the web page of the revision."""
        if self.pull:  # the page of its branch (refs/pr/N) has no button to merge it
            return f"{self.page}/discussions/{self.pull.rpartition('/')[2]}"
        if self.revision is None:
            return self.page
        return f"{self.page}/tree/{self.revision}"

    @property
    def is_private(self) -> bool:
        """Whether the repository is private, or will be if it does not exist yet."""
        return self.options.private if self.held is None else self.held.is_private

    @property
    def sent(self) -> tuple[str, ...]:
        """Files that were sent; none before :meth:`send`."""
        if self.commit is None:
            return ()
        return tuple(file.path for file in self.plan.to_send)

    @property
    def removed(self) -> tuple[str, ...]:
        """Files that were removed; none before :meth:`send`."""
        return () if self.commit is None else self.plan.removed

    def send(self) -> Upload:
        """Send the missing files, compare the result, set the tag, and return the upload with its commit.

        After a transient failure the files are compared again and the missing ones sent, none if only the
        answer was lost. Raises HubError (files that were sent stay on the Hub, and the same call continues)
        or IntegrityError (afterwards the Hub does not hold what the folder has).
        """
        import huggingface_hub  # heavy, and help texts read this file

        api = huggingface_hub.HfApi()
        ask = self.ask
        options = self.options
        here: JsonDict = {"repo_id": self.repo_id, "repo_type": "dataset"}
        # exist_ok: another upload may have made them meanwhile, or an answer was lost.
        if self.held is None:
            ask(partial(api.create_repo, **here, private=options.private, exist_ok=True))
        if not (self.has_branch or options.is_main):
            start = None if self.held is None else self.held.commit
            ask(partial(api.create_branch, **here, branch=options.branch, revision=start, exist_ok=True))
        # If only the answer was lost, a second attempt would open a second pull request.
        commit, pull = ask(partial(_send, self), waits_s=() if options.create_pr else None)
        # Not HfApi.verify_repo_checksums (from 1.1 on), which reads all files of one folder again.
        now = ask(partial(listing, self.repo_id, commit))
        wrong = compare(self.files, now, delete=options.delete)
        if not wrong.is_done:
            paths = [*(file.path for file in wrong.to_send), *wrong.removed]
            raise IntegrityError(
                f"{self.repo_id!r} does not hold what was sent (commit {commit[:12]}): "
                f"{paths[0]} differs ({wording.with_count(len(paths), 'such files')})",
                next="run the same upload again, which sends what is missing",
            )
        if options.tag:
            ask(partial(api.create_tag, **here, tag=options.tag, revision=commit, exist_ok=True))
        return replace(self, commit=commit, pull=pull)


def check_folder(
    folder: store.DataFolder, kind: DatasetKind | None = None, workers: int = 1
) -> Iterable[object]:
    """List the problems of a folder: files and card; with a kind also rows, columns, ids and pictures.

    As text, each is the file and what is wrong with it; kinds have classes of their own for them.
    """
    if kind is not None and kind.check is not None:
        findings: Iterable[object] = kind.check(folder, workers)
        return findings
    schema = None
    if kind is not None:
        schema = kind.schema_of(folder_place(folder).require_manifest(kind))
    return cards.verify(folder, schema, workers).findings


def _asking(repo_id: str, on_wait: Callable[[str], None]) -> _Ask:
    """Return a function that calls others for a repository, with retries; InputError for a wrong name."""
    if hub.hub_name(repo_id) != HubName(repo_id, None, ""):
        raise InputError(f"{repo_id!r} is not a name of a repository", next="give USER/NAME")
    return partial(call_with_retry, repo_id=repo_id, doing="uploading to", on_wait=on_wait)


def _compared(
    repo_id: str,
    chosen: UploadOptions,
    state: _State,
    files: tuple[LocalFile, ...],
    ask: _Ask,
    what: str,
) -> Upload:
    """Compare files with the state of a repository; InputError if it or its tag must not change."""
    held, tags, has_branch = state
    plan = compare(files, held, delete=chosen.delete)
    _refuse_public(repo_id, chosen, held)
    named = tags.get(chosen.tag or "")
    if named and not (plan.is_done and held and held.commit == named):
        raise InputError(
            f"tag {chosen.tag!r} of {repo_id!r} names commit {named[:12]} already; nothing was sent",
            next="choose another --tag, or delete that one on the Hub",
        )
    options = replace(chosen, tag=None) if named else chosen
    return Upload(repo_id, options, held, has_branch, files, plan, ask, what)


def _refuse_public(repo_id: str, options: UploadOptions, held: hub.HubRepository | None) -> None:
    """Refuse to upload private data to a public repository."""
    if options.private and held is not None and not held.is_private:
        raise InputError(
            f"{repo_id!r} exists and everyone can see it, but --private was given; nothing was sent",
            next=f"make it private at {page_of(repo_id)}/settings, or leave --private out",
        )


def _asked_state(ask: _Ask, repo_id: str, branch: str, *, dry_run: bool) -> tuple[_State, str]:
    """Return :func:`_state`; if a dry run cannot reach the Hub, the state of a new repository, and why."""
    import huggingface_hub  # heavy, and help texts read this file

    state = partial(_state, repo_id, branch)
    if not dry_run:
        ask(huggingface_hub.HfApi().whoami)
        return ask(state), ""
    try:
        return ask(state, waits_s=()), ""
    except HubError as error:
        return (None, {}, False), error.what


def _state(repo_id: str, branch: str) -> _State:
    """Return the head of a branch, the commits of the tags, and whether the branch exists.

    A missing repository is not an error.
    """
    import huggingface_hub  # heavy, and help texts read this file

    # The client does not load this module on first use.
    from huggingface_hub import errors

    try:
        refs = huggingface_hub.HfApi().list_repo_refs(repo_id, repo_type="dataset")
    except errors.RepositoryNotFoundError as error:
        # The client derives it from the error for a missing repository, but a gated one exists.
        if isinstance(error, errors.GatedRepoError):
            raise
        return None, {}, False
    tags = {ref.name: str(ref.target_commit) for ref in refs.tags}
    # Pull requests are not listed.
    exists = branch.startswith("refs/") or branch in {ref.name for ref in refs.branches}
    return listing(repo_id, branch if exists else MAIN_BRANCH), tags, exists


def local_copy(folder: FsspecFolder, root: Path) -> store.DataFolder:
    """Copy all visible files of a folder to this machine.

    Raises IntegrityError for names that lead out of a folder, StorageError if the disk is full, and
    RemoteError if the store fails.
    """
    visible = [path for path in folder.walk() if not store.is_hidden(path)]
    paths = store.names_inside(visible, repr(folder.address()))
    for _ in run.in_threads(lambda path: folder.download(path, root / path), paths, _THREADS):
        pass
    return store.open_folder(str(root))


def _require_sound(findings: Iterable[object]) -> None:
    problems = [str(finding).partition("; next: ")[0] for finding in findings]
    if problems:
        more = f" and {len(problems) - 3} more" if len(problems) > 3 else ""
        raise IntegrityError(
            f"nothing was uploaded, because the folder has problems: {'; '.join(problems[:3])}{more}",
            next="run the command that made it again, or the command `card` if only the card is wrong",
        )


def _files_to_send(
    folder: store.DataFolder,
    manifest: store.Manifest,
    repo_id: str,
    held: hub.HubRepository | None,
    options: UploadOptions,
    scratch: Path,
) -> tuple[store.Manifest, tuple[LocalFile, ...]]:
    """Collect the files to send, with the card for the Hub."""
    root = Path(folder.address())
    made = dict[str, str]()
    if options.viewer:
        from tactile_toolkit.exchange.copies import viewer_tables  # meshes

        made = viewer_tables(folder, manifest, scratch)
        manifest = replace(manifest, files={**manifest.files, **made})
    paths = collect(root, manifest)
    facts = cards.FolderSummary.of(folder, manifest)
    # If the pattern of a split would match another file of the repository, its files are listed one by one.
    others, _ = _other_files(paths, {} if held is None else held.remote, options.delete)
    stored = with_repo_name(folder.read_bytes(store.CARD_FILE).decode(), repo_id)
    card = yaml_head.with_head(stored, lambda head: head.update(configs=yaml_head.configs(facts, others)))
    rendered = {store.CARD_FILE: card}
    if made:
        rendered[store.MANIFEST_FILE] = manifest.to_json()
    for path, content in rendered.items():
        (scratch / path).write_bytes(content.encode())
    known = {record.file: record.sha256 for record in manifest.shards} | dict(manifest.files)
    local_paths = {path: root / path for path in paths} | {
        path: scratch / path for path in (*made, *rendered)
    }
    return manifest, tuple(
        LocalFile(path, local_path, local_path.stat().st_size, known.get(path))
        for path, local_path in local_paths.items()
    )


def _send(upload: Upload) -> tuple[str, str | None]:
    """Send the files that are missing now as one commit; return it, and the pull request that it opened.

    Not with ``upload_folder``: it may make several commits, between which readers would find a part of the
    files; and it takes all files from one folder, while the card is in another.
    """
    import huggingface_hub  # heavy, and help texts read this file

    options = upload.options
    held = _state(upload.repo_id, options.branch)[0]
    _refuse_public(upload.repo_id, options, held)  # another upload may have created it meanwhile
    plan = compare(upload.files, held, delete=options.delete)
    if plan.is_done and held is not None:
        return held.commit, None
    message = f"Upload {upload.what}"
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # warnings of the client, on which users cannot act
        made = huggingface_hub.HfApi().create_commit(
            repo_id=upload.repo_id,
            operations=[
                *(huggingface_hub.CommitOperationDelete(path) for path in plan.removed),
                *(huggingface_hub.CommitOperationAdd(file.path, file.local_path) for file in plan.to_send),
            ],
            repo_type="dataset",
            commit_message=options.message or message,
            revision=None if options.create_pr else options.branch,
            create_pr=options.create_pr,
        )
    return str(made.oid), made.pr_revision
