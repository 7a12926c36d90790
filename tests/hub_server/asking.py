"""Requests to the server with everything that decides the reply, and kinds of replies."""

from __future__ import annotations

import json
from dataclasses import dataclass, field
from email.message import Message
from typing import TYPE_CHECKING, Any
from urllib.parse import SplitResult, parse_qs

from tests.hub_server.repositories import Account, Commit, Repository

if TYPE_CHECKING:
    from tests.hub_server.server import HubServer


@dataclass
class Reply:
    """A reply: values become JSON, bytes are the content of a file."""

    status: int = 200
    value: Any = None
    headers: dict[str, str] = field(default_factory=dict)

    @property
    def is_content(self) -> bool:
        """Whether the body is the content of a file."""
        return isinstance(self.value, bytes)

    @property
    def content(self) -> bytes:
        """The body."""
        if isinstance(self.value, bytes):
            return self.value
        return b"" if self.value is None else json.dumps(self.value).encode()


class Refusal(Exception):  # noqa: N818 - a normal reply, not an error of the server
    """The Hub refuses the request."""

    def __init__(self, status: int, message: str, code: str = "") -> None:
        super().__init__(message)
        headers = {"X-Error-Message": message} | ({"X-Error-Code": code} if code else {})
        self.reply = Reply(status, {"error": message}, headers)


@dataclass
class Asked:
    """A request with everything that decides the reply."""

    hub: HubServer
    method: str
    address: SplitResult
    headers: Message
    account: Account | None
    has_token: bool
    body: bytes = b""
    names: dict[str, str] = field(default_factory=dict)

    @property
    def json(self) -> Any:
        """The JSON value of the body."""
        return json.loads(self.body or b"{}")

    @property
    def query(self) -> dict[str, str]:
        """The query: the last value of each name."""
        return {name: values[-1] for name, values in parse_qs(self.address.query).items()}

    def repository(self) -> Repository:
        """Return the requested repository, if the account may see it."""
        found = self.hub.find(self.names.get("kind", "models"), self.names["repo"])
        if found is None or not _may_see(found, self.account):
            # The Hub replies for private repositories as for missing ones. Its 401 has no error code;
            # clients then recognise it by an https address, which this server does not have.
            raise Refusal(404 if self.account else 401, "Repository not found", "RepoNotFound")
        return found

    def commit(self, repository: Repository) -> Commit:
        """Return the requested commit."""
        found = repository.find(self.names.get("revision") or "main")
        if found is None:
            raise Refusal(404, f"Invalid rev id: {self.names['revision']}", "RevisionNotFound")
        return found

    def writer(self, namespace: str, *, anyone: bool = False) -> Account:
        """Return the account if it may write under a name."""
        if self.account is None:
            raise Refusal(401, "Invalid username or password.")
        if self.account.role != "write":
            raise Refusal(403, "Your token does not have write access: use a token with the write role")
        if not anyone and not self.account.owns(namespace):
            raise Refusal(403, f"You don't have the rights to write under the namespace {namespace!r}")
        return self.account


def _may_see(repository: Repository, account: Account | None) -> bool:
    return not repository.private or (account is not None and account.owns(repository.namespace))


def require_passed_gate(repository: Repository, account: Account | None) -> None:
    passed = account is not None and (
        account.name in repository.granted or account.owns(repository.namespace)
    )
    if repository.gated and not passed:
        message = f"Access to dataset {repository.id} is restricted and you are not in the authorized list."
        raise Refusal(403 if account else 401, message, "GatedRepo")
