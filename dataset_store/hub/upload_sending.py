"""The effects of an upload: sending until it is there, comparing what arrived, naming it."""

from __future__ import annotations

from collections.abc import Iterator

from dataset_store.errors import IntegrityError
from dataset_store.hub.retries import ask
from dataset_store.hub.upload_payload import staged
from dataset_store.hub.upload_plan import compare
from dataset_store.hub.upload_steps import PreparedUpload
from dataset_store.hub.upload_target import MAIN, Sent

__all__ = ["ensure_sent", "holding_pull", "require_arrival", "tagged"]


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
            self._send, target.repo_id, target.branch, "uploading to", look=self._look, on_wait=target.on_wait
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
