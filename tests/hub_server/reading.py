"""Replies to read requests: account, repositories, lists of files, and their content."""

from __future__ import annotations

import re
from typing import Any
from urllib.parse import parse_qs, quote

import yaml

from tests.hub_server.asking import Asked, Refusal, Reply, require_passed_gate
from tests.hub_server.repositories import Blob


def whoami(asked: Asked) -> Reply:
    if asked.account is None:
        raise Refusal(401, "Invalid username or password.")
    account = asked.account
    token = {"displayName": "test", "role": account.role, "createdAt": "2026-01-01T00:00:00.000Z"}
    organizations = [{"type": "org", "name": name, "roleInOrg": "write"} for name in account.organizations]
    return Reply(
        200,
        {
            "type": "user",
            "name": account.name,
            "fullname": account.name,
            "orgs": organizations,
            "auth": {"type": "access_token", "accessToken": token},
        },
    )


def validate_yaml(asked: Asked) -> Reply:
    head = re.match(r"---\n(.*?)\n---", asked.json["content"], flags=re.DOTALL)
    if head is None:
        return Reply(200, {"warnings": [], "errors": []})
    try:
        wrong = [] if isinstance(yaml.safe_load(head[1]), dict) else ["metadata should be a mapping"]
    except yaml.YAMLError as error:
        wrong = [str(error)]
    return Reply(400 if wrong else 200, {"warnings": [], "errors": [{"message": text} for text in wrong]})


def _card_head(text: str) -> Any:
    """Return the YAML head of a card; None if no head can be read."""
    head = re.match(r"---\n(.*?)\n---", text, flags=re.DOTALL)
    try:
        return yaml.safe_load(head[1]) if head else None
    except (yaml.YAMLError, RecursionError):
        return None


def info(asked: Asked) -> Reply:
    repository = asked.repository()
    commit = asked.commit(repository)
    siblings: list[dict[str, Any]] = [{"rfilename": path} for path in sorted(commit.files)]
    if "blobs" in asked.query:
        for sibling in siblings:
            blob = commit.files[sibling["rfilename"]]
            sibling |= {"size": len(blob.content), "blobId": blob.oid}
            if blob.is_lfs:
                pointer_size = len(blob.pointer)
                sibling["lfs"] = {"size": sibling["size"], "sha256": blob.sha256, "pointerSize": pointer_size}
    readme = commit.files.get("README.md")
    card = _card_head(readme.content.decode()) if readme else None
    used = sum(len(blob.content) for blob in commit.files.values())
    return Reply(
        200,
        {
            "id": repository.id,
            "author": repository.namespace,
            "sha": commit.sha,
            "private": repository.private,
            "gated": repository.gated,
            "disabled": False,
            "downloads": 0,
            "likes": 0,
            "tags": [],
            "usedStorage": used,
            **({"cardData": card} if card else {}),
            "siblings": siblings,
        },
    )


def _entry(path: str, blob: Blob) -> dict[str, Any]:
    entry: dict[str, Any] = {"type": "file", "path": path, "size": len(blob.content), "oid": blob.oid}
    if blob.is_lfs:
        entry["lfs"] = {"oid": blob.sha256, "size": len(blob.content), "pointerSize": len(blob.pointer)}
    return entry


def _folder(path: str) -> dict[str, Any]:
    return {"type": "directory", "path": path, "size": 0, "oid": "0" * 40}


def tree(asked: Asked) -> Reply:
    commit = asked.commit(asked.repository())
    prefix = f"{asked.names['path']}/" if "path" in asked.names else ""
    recursive = asked.query.get("recursive", "").lower() in ("true", "1")
    entries: dict[str, dict[str, Any]] = {}
    for path, blob in sorted(commit.files.items()):
        if not path.startswith(prefix):
            continue
        parts = path.removeprefix(prefix).split("/")
        for depth in range(1, len(parts)):
            folder = prefix + "/".join(parts[:depth])
            if recursive or depth == 1:
                entries.setdefault(folder, _folder(folder))
        if recursive or len(parts) == 1:
            entries[path] = _entry(path, blob)
    if prefix and not entries:
        raise Refusal(404, f"{prefix} does not exist", "EntryNotFound")
    return Reply(200, list(entries.values()))


def paths_info(asked: Asked) -> Reply:
    commit = asked.commit(asked.repository())
    is_json = "json" in (asked.headers.get("Content-Type") or "")
    values = asked.json if is_json else parse_qs(asked.body.decode())
    entries = []
    for path in values.get("paths", []):
        if path in commit.files:
            entries.append(_entry(path, commit.files[path]))
        elif any(name.startswith(f"{path}/") for name in commit.files):
            entries.append(_folder(path))
    return Reply(200, entries)


def refs(asked: Asked) -> Reply:
    repository = asked.repository()
    pulls = {f"refs/pr/{number}": sha for number, sha in repository.pulls.items()}

    def listed(names: dict[str, str], prefix: str) -> list[dict[str, str]]:
        return [{"name": name, "ref": prefix + name, "targetCommit": sha} for name, sha in names.items()]

    return Reply(
        200,
        {
            "branches": listed(repository.branches, "refs/heads/"),
            "tags": listed(repository.tags, "refs/tags/"),
            "converts": [],
            "pullRequests": listed(pulls, ""),
        },
    )


def resolve(asked: Asked) -> Reply:
    repository = asked.repository()
    require_passed_gate(repository, asked.account)
    commit = asked.commit(repository)
    path = asked.names["path"]
    blob = commit.files.get(path)
    if blob is None:
        refusal = Refusal(404, "Entry not found", "EntryNotFound")
        refusal.reply.headers["X-Repo-Commit"] = commit.sha
        raise refusal
    headers = {"X-Repo-Commit": commit.sha, "ETag": f'"{blob.oid}"', "Accept-Ranges": "bytes"}
    if not blob.is_lfs:
        return Reply(200, blob.content, headers)
    headers |= {"X-Linked-Etag": f'"{blob.sha256}"', "X-Linked-Size": str(len(blob.content))}
    place = f"{asked.hub.cdn}/cdn/{repository.kind}/{repository.id}/{blob.sha256}/{quote(path)}"
    return Reply(302, None, headers | {"Location": place})


def cdn(asked: Asked) -> Reply:
    repository = asked.hub.find(asked.names["kind"], asked.names["repo"])
    content = repository.objects.get(asked.names["oid"]) if repository else None
    if content is None:
        raise Refusal(403, "no such signed address")
    return Reply(200, content, {"ETag": f'"{asked.names["oid"]}"', "Accept-Ranges": "bytes"})
