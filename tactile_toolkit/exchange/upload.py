"""Bringing a data set folder to the Hugging Face Hub.

First everything is looked at and nothing is changed (:func:`prepare_upload`): is the folder whole, what has
the Hub already. Then what is missing is sent (:func:`run_upload`), and what arrived is compared by checksum.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from fnmatch import fnmatch
from pathlib import Path
from typing import Any

from tactile_toolkit.cards.card import CARD_FILE, addressed
from tactile_toolkit.cards.checks import check_card
from tactile_toolkit.cards.head import head_text
from tactile_toolkit.errors import InputError, IntegrityError
from tactile_toolkit.exchange.upload_plan import compare
from tactile_toolkit.exchange.upload_target import (
    MAIN,
    Payload,
    PreparedUpload,
    RemoteState,
    Sent,
    UploadOptions,
    UploadResult,
    UploadTarget,
    collect,
    staged,
)
from tactile_toolkit.hub.errors import require_repository_name
from tactile_toolkit.hub.retry import ask
from tactile_toolkit.store.folder import DataFolder
from tactile_toolkit.store.manifest import MANIFEST_FILE, Manifest, read_manifest
from tactile_toolkit.store.shards import Finding
from tactile_toolkit.store.verify import verify

__all__ = [
    "PreparedUpload",
    "UploadOptions",
    "UploadResult",
    "card_for_hub",
    "ensure_sent",
    "holding_pull",
    "prepare_upload",
    "require_arrival",
    "run_upload",
    "tagged",
]

_FENCE = "---\n"


def card_for_hub(text: str, repo_id: str, shards: Mapping[str, Sequence[str]], others: Iterable[str]) -> str:
    """Render the card of a folder for a repository.

    Parameters
    ----------
    text : str
        Card of the folder.
    repo_id : str
        ``USER/NAME``, which takes the place of the folder in lines that load the data set.
    shards : mapping of str to sequence of str
        Files of each split in the folder.
    others : iterable of str
        Files that stay in the repository though the folder lacks them. Where the pattern of a split would
        take them for its own, the split's files are named one by one instead.
    """
    named = addressed(text, repo_id)
    foreign = list(others)
    _, head, body = named.split(_FENCE, 2)
    values = _parsed(head)
    if not any(_takes(entry, foreign) for entry in _data_files(values)):
        return named
    for entry in _data_files(values):
        if _takes(entry, foreign):
            entry["path"] = list(shards[entry["split"]])
    return head_text(values) + body


def _parsed(head: str) -> dict[str, Any]:
    import yaml

    values: dict[str, Any] = yaml.safe_load(head)
    return values


def _data_files(values: Mapping[str, Any]) -> list[dict[str, Any]]:
    entries: list[dict[str, Any]] = values["configs"][0]["data_files"]
    return entries


def _takes(entry: Mapping[str, Any], paths: Sequence[str]) -> bool:
    pattern = entry["path"]
    return isinstance(pattern, str) and any(fnmatch(path, pattern) for path in paths)


def holding_pull(prepared: PreparedUpload, author: str) -> str | None:
    """Return an open pull request of ours that holds everything already."""
    for pull in prepared.target.open_pulls(author):
        plan = compare(prepared.payload.files, prepared.target.files_at(pull))
        if plan.is_done(delete=prepared.options.delete):
            return pull
    return None


def ensure_sent(prepared: PreparedUpload) -> tuple[Sent, bool]:
    """Make the Hub hold the folder; tell where, and whether anything had to be sent for it.

    Raises
    ------
    HubError
        The Hub refused, or failed more often than is worth waiting.
    """
    target, options = prepared.target, prepared.options
    if prepared.pull is not None:
        return Sent(target.commit_of(prepared.pull), prepared.pull), False
    if not prepared.state.exists:
        target.create(private=options.private)
    if not prepared.state.has_branch and target.branch != MAIN:
        target.create_branch(prepared.state.head)
    if prepared.is_done and prepared.state.head is not None:
        return Sent(prepared.state.head), False
    return _Sending(prepared).until_there(), True


class _Sending:
    """Sending until it is there: each try starts from what the Hub holds at that moment."""

    def __init__(self, prepared: PreparedUpload) -> None:
        self._prepared = prepared
        self._plan = prepared.plan
        self._head = prepared.state.head

    def until_there(self) -> Sent:
        """Send, and try again what fails in passing, but never what has had its effect."""
        target = self._prepared.target
        return ask(
            self._send,
            target.repo_id,
            target.branch,
            "uploading to",
            find_result=self._look,
            on_wait=target.on_wait,
        )

    def _send(self) -> Sent:
        prepared = self._prepared
        with staged(prepared.payload, self._plan.to_send) as stage:
            return prepared.target.send(
                stage,
                prepared.message,
                delete=[file.path for file in self._plan.remote_only] if prepared.options.delete else [],
                parent=self._head,
                pull=prepared.options.create_pr,
            )

    def _look(self) -> Sent | None:
        """Look whether the commit was made although its answer did not arrive."""
        prepared, target = self._prepared, self._prepared.target
        if prepared.options.create_pr:
            pull = holding_pull(prepared, target.who())
            return None if pull is None else Sent(target.commit_of(pull), pull)
        state = target.state()
        self._plan, self._head = compare(prepared.payload.files, state.files), state.head
        if state.head is not None and self._plan.is_done(delete=prepared.options.delete):
            return Sent(state.head)
        return None


def require_arrival(prepared: PreparedUpload, sent: Sent) -> None:
    """Compare every file of the commit with the folder, by checksum.

    Raises
    ------
    IntegrityError
        A file is missing there or differs; names it.
    """
    arrived = compare(prepared.payload.files, prepared.target.files_at(sent.commit))
    wrong = [
        *(f"{file.path} is missing" for file in arrived.new),
        *(f"{f.path} differs" for f in arrived.changed),
    ]
    if prepared.options.delete:
        wrong += [f"{file.path} is still there" for file in arrived.remote_only]
    if wrong:
        message = (
            f"{prepared.target.repo_id!r} does not hold what was sent (commit {sent.commit[:12]}): "
            f"{'; '.join(wrong[:3])} ({len(wrong)} such files); next: run the same upload again, it sends "
            "what is missing"
        )
        raise IntegrityError(message)


def tagged(prepared: PreparedUpload, sent: Sent) -> Iterator[str]:
    """Set the names that do not name the commit yet, and yield them."""
    for tag in prepared.tags:
        there = prepared.state.tags.get(tag)
        if there != sent.commit:
            prepared.target.set_tag(tag, sent.commit, there)
            yield tag


Check = Callable[[DataFolder], Iterable[Finding]]
"""Lists what is wrong with a folder."""


def prepare_upload(
    folder: str,
    repo_id: str,
    options: UploadOptions | None = None,
    *,
    check: Check | None = None,
    dry_run: bool = False,
    on_wait: Callable[[str], None] = lambda _: None,
) -> PreparedUpload:
    """Verify a folder, render its card, and compare it with the repository; nothing is changed anywhere.

    Parameters
    ----------
    folder : str
        Local folder of a finished data set.
    repo_id : str
        ``USER/NAME``.
    options : UploadOptions, optional
        What the user decides.
    check : callable, optional
        Lists what is wrong with the folder; `tactile_toolkit.store.verify.verify` with the card if not given.
    dry_run : bool
        Do without a login where the repository can be seen without one.
    on_wait : callable
        Told, in a sentence, of each wait before a request is tried again.

    Returns
    -------
    PreparedUpload

    Raises
    ------
    InputError
        No finished data set is there, or an option cannot be used.
    IntegrityError
        The folder is damaged, or its card does not tell the truth.
    HubError
        Not logged in, not allowed, or the Hub cannot be reached.
    """
    chosen = options or UploadOptions()
    require_repository_name(repo_id)
    root, manifest = _finished(folder)
    _require_sound(root, list((check or _verified)(DataFolder(str(root)))))
    target = UploadTarget(repo_id, chosen.revision or MAIN, on_wait)
    name = "" if dry_run else target.who()
    state = target.state()
    _refuse_exposure(target, chosen, state)
    _refuse_taken_names(target, chosen, state)
    payload = _payload(root, manifest, repo_id, chosen, state)
    plan = compare(payload.files, state.files)
    prepared = PreparedUpload(target, chosen, manifest, payload, state, plan)
    _refuse_other_tag(prepared)
    if chosen.create_pr and state.exists and name and not prepared.is_done:
        return replace(prepared, pull=holding_pull(prepared, name))
    return prepared


def run_upload(prepared: PreparedUpload) -> UploadResult:
    """Send what is missing, compare what arrived, and name it.

    A commit whose answer was lost is looked for before it is tried again, so that none is made twice.

    Raises
    ------
    HubError
        The Hub refused, or failed more often than is worth waiting. What was sent stays there, and the same
        call goes on from it.
    IntegrityError
        What the Hub holds afterwards is not what the folder has.
    """
    sent, did_send = ensure_sent(prepared)
    require_arrival(prepared, sent)
    return UploadResult(
        sent.commit,
        sent.pull,
        tuple(file.path for file in prepared.plan.to_send) if did_send else (),
        prepared.removed if did_send else (),
        tuple(tagged(prepared, sent)),
    )


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


def _finished(folder: str) -> tuple[Path, Manifest]:
    place = DataFolder(folder)
    if not place.is_local:
        message = f"{folder!r} is no local folder; next: copy it to this machine, then upload it"
        raise InputError(message)
    manifest = read_manifest(place)
    if manifest is None:
        message = (
            f"no {MANIFEST_FILE} in {place.address()!r}: only data sets made by this toolkit can be proved "
            "whole before they are sent; next: give the folder of one"
        )
        raise InputError(message)
    return Path(place.address()), manifest


def _verified(folder: DataFolder) -> Sequence[Finding]:
    return verify(folder, check_card=check_card).findings


def _require_sound(root: Path, findings: Sequence[Finding]) -> None:
    if not findings:
        return
    told = [f"{finding.file} {finding.problem}".partition("; next: ")[0] for finding in findings[:3]]
    listed = "; ".join(told)
    more = f" and {len(findings) - 3} more" if len(findings) > 3 else ""
    only_card = all(CARD_FILE in (finding.file, *finding.problem.split()) for finding in findings)
    cure = "write it with the command `card`, or mend it by hand"
    cure = cure if only_card else "run the command that made it again, or `card` for the card alone"
    message = f"{str(root)!r} is not fit to be sent, nothing was: {listed}{more}; next: {cure}"
    raise IntegrityError(message)


def _payload(
    root: Path, manifest: Manifest, repo_id: str, options: UploadOptions, state: RemoteState
) -> Payload:
    """Collect the files, with the card as it is to be on the Hub, checked as such."""
    stored = (root / CARD_FILE).read_text(encoding="utf-8")
    payload = collect(root, manifest, stored.encode())
    staying = () if options.delete else compare(payload.files, state.files).remote_only
    shards = {split: [r.shard.data_path for r in manifest.shards_of(split)] for split in manifest.splits}
    text = card_for_hub(stored, repo_id, shards, [file.path for file in staying])
    held = {*(file.path for file in payload.files), *(file.path for file in staying)}
    _require_sound(root, check_card(DataFolder(str(root)), text, held=held))
    return payload.with_card(text.encode())


def _refuse_exposure(target: UploadTarget, options: UploadOptions, state: RemoteState) -> None:
    if options.private and state.exists and not state.private:
        message = (
            f"{target.repo_id!r} exists and everyone can see it, --private was asked for; nothing was sent; "
            f"next: make it private at {target.page}/settings, or leave --private out"
        )
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
