"""Replies to requests that change repositories: names of commits, large files, commits."""

from __future__ import annotations

import base64
import binascii
import json
from typing import Any

from tests.hub_server.asking import Asked, Refusal, Reply
from tests.hub_server.repositories import Blob, Commit, Repository


def create(asked: Asked) -> Reply:
    values = asked.json
    kind = f"{values.get('type') or 'model'}s"
    namespace = values.get("organization") or (asked.account.name if asked.account else "")
    asked.writer(namespace)
    name = f"{namespace}/{values['name']}"
    url = f"{asked.hub.endpoint}/{'' if kind == 'models' else kind + '/'}{name}"
    if asked.hub.find(kind, name) is not None:
        message = {"error": "You already created this repo", "url": url}
        return Reply(409, message, {"X-Error-Message": "You already created this repo"})
    private = values.get("private") or values.get("visibility") == "private"
    asked.hub.create(name, kind=kind, private=bool(private))
    return Reply(200, {"url": url, "name": name})


def branch(asked: Asked) -> Reply:
    repository = asked.repository()
    asked.writer(repository.namespace)
    name = asked.names["name"]
    if name in repository.branches:
        raise Refusal(409, f"Reference already exists: refs/heads/{name}")
    start = repository.find(asked.json.get("startingPoint") or "main")
    if start is None:
        raise Refusal(404, "Invalid rev id", "RevisionNotFound")
    repository.branches[name] = start.sha
    return Reply(200, {})


def tag(asked: Asked) -> Reply:
    repository = asked.repository()
    asked.writer(repository.namespace)
    name = asked.json["tag"]
    if name in repository.tags:
        raise Refusal(409, f"Tag reference exists already: refs/tags/{name}")
    repository.tags[name] = asked.commit(repository).sha
    return Reply(200, {})


def preupload(asked: Asked) -> Reply:
    repository = asked.repository()
    asked.writer(repository.namespace, anyone="create_pr" in asked.query)
    commit = asked.commit(repository)
    files = []
    for file in asked.json["files"]:
        path = file["path"]
        sample = base64.b64decode(file.get("sample") or b"")
        there = commit.files.get(path)
        is_lfs = repository.is_lfs(path, file["size"], sample)
        files.append(
            {
                "path": path,
                "uploadMode": "lfs" if is_lfs else "regular",
                "shouldIgnore": False,
                **({"oid": there.etag} if there else {}),
            }
        )
    return Reply(200, {"files": files})


def commit(asked: Asked) -> Reply:
    repository = asked.repository()
    pull = asked.query.get("create_pr") == "1"
    account = asked.writer(repository.namespace, anyone=pull)
    base = asked.commit(repository)
    lines = [json.loads(line) for line in asked.body.splitlines() if line.strip()]
    header = next(line["value"] for line in lines if line["key"] == "header")
    if header.get("parentCommit") not in (None, base.sha):
        raise Refusal(412, "A commit has happened since. Please refresh and try again.")
    changes = dict(_change(repository, base, line) for line in lines if line["key"] != "header")
    ref = repository.open_pull() if pull else asked.names["revision"]
    if ref not in repository.branches and not ref.startswith("refs/"):
        raise Refusal(404, f"Invalid rev id: {ref}", "RevisionNotFound")
    made = repository.commit(
        changes, header["summary"], description=header.get("description", ""), author=account.name, ref=ref
    )
    page = f"{asked.hub.endpoint}/{repository.kind}/{repository.id}"
    number = ref.rpartition("/")[2]
    return Reply(
        200,
        {
            "success": True,
            "commitOid": made.sha,
            "commitUrl": f"{page}/commit/{made.sha}",
            "pullRequestUrl": f"{page}/discussions/{number}" if pull else None,
        },
    )


def _change(repository: Repository, base: Commit, line: dict[str, Any]) -> tuple[str, Blob | None]:
    value = line["value"]
    path = value["path"]
    if line["key"] == "file":
        try:
            return path, Blob(base64.b64decode(value["content"], validate=True), is_lfs=False)
        except binascii.Error as error:
            raise Refusal(400, f"{path} is not encoded in base64") from error
    if line["key"] == "lfsFile":
        content = repository.objects.get(value["oid"])
        if content is None:
            raise Refusal(400, f"Your push was rejected: the large file {value['oid']} of {path} is not here")
        return path, Blob(content, is_lfs=True)
    there = [name for name in base.files if name == path or name.startswith(path.rstrip("/") + "/")]
    if not there:
        raise Refusal(404, f"A file with this name doesn't exist: {path}", "EntryNotFound")
    return path, None


def lfs_batch(asked: Asked) -> Reply:
    repository = asked.repository()
    asked.writer(repository.namespace, anyone=True)
    objects = []
    for wanted in asked.json["objects"]:
        oid, entry = wanted["oid"], dict(wanted)
        if oid not in repository.objects:
            place = f"{asked.hub.cdn}/lfs/{repository.kind}/{repository.id}/{oid}"
            verify = f"{asked.hub.endpoint}/lfs-verify/{repository.kind}/{repository.id}/{oid}"
            entry["actions"] = {"upload": {"href": place}, "verify": {"href": verify}}
        objects.append(entry)
    return Reply(200, {"transfer": "basic", "objects": objects})


def lfs_upload(asked: Asked) -> Reply:
    repository = asked.hub.find(asked.names["kind"], asked.names["repo"])
    oid = asked.names["oid"]
    if repository is None:
        raise Refusal(404, "no such place")
    if Blob(asked.body, is_lfs=True).sha256 != oid:
        raise Refusal(400, f"the content's SHA-256 is not {oid}")
    repository.objects[oid] = asked.body
    return Reply(200, {})


def lfs_verify(asked: Asked) -> Reply:
    content = asked.repository().objects.get(asked.json["oid"])
    if content is None or len(content) != asked.json["size"]:
        raise Refusal(404, "the large file did not arrive whole")
    return Reply(200, {})
