"""Routes: the parts of the API of the Hub that its Python clients use."""

from __future__ import annotations

import re
from collections.abc import Callable
from urllib.parse import unquote

from tests.hub_server import reading, writing
from tests.hub_server.asking import Asked, Refusal, Reply


def answer(asked: Asked) -> Reply:
    """Reply to a request."""
    if asked.has_token and asked.account is None:
        raise Refusal(401, "Invalid credentials in Authorization header")
    for methods, pattern, respond in _ROUTES:
        match = pattern.fullmatch(asked.address.path)
        if match and asked.method in methods:
            asked.names = {name: unquote(text) for name, text in match.groupdict().items() if text}
            with asked.hub.lock:
                return respond(asked)
    raise Refusal(404, f"nothing answers {asked.method} {asked.address.path}")


_NAMES = {
    "{api}": "/api/{repo}",
    "{repo}": r"(?P<kind>\w+)/(?P<repo>[^/]+/[^/]+)",
    "{model}": "(?P<repo>[^/]+/[^/]+)",
    "{revision}": "(?P<revision>[^/]+)",
    "{name}": "(?P<name>[^/]+)",
    "{oid}": r"(?P<oid>\w{64})",
    "{path}": "(?P<path>.+)",
}


def _pattern(path: str) -> re.Pattern[str]:
    for name, pattern in _NAMES.items():
        path = path.replace(name, pattern)
    return re.compile(path)


_ANSWERS: tuple[tuple[str, str, Callable[[Asked], Reply]], ...] = (
    ("GET", "/api/whoami-v2", reading.whoami),
    ("POST", "/api/repos/create", writing.create),
    ("POST", "/api/validate-yaml", reading.validate_yaml),
    ("GET", "{api}", reading.info),
    ("GET", "{api}/revision/{revision}", reading.info),
    ("GET", "{api}/tree/{revision}", reading.tree),
    ("GET", "{api}/tree/{revision}/{path}", reading.tree),
    ("POST", "{api}/paths-info/{revision}", reading.paths_info),
    ("GET", "{api}/refs", reading.refs),
    ("POST", "{api}/branch/{name}", writing.branch),
    ("POST", "{api}/tag/{revision}", writing.tag),
    ("POST", "{api}/preupload/{revision}", writing.preupload),
    ("POST", "{api}/commit/{revision}", writing.commit),
    ("POST", "/{repo}[.]git/info/lfs/objects/batch", writing.lfs_batch),
    ("POST", "/{model}[.]git/info/lfs/objects/batch", writing.lfs_batch),
    ("PUT", "/lfs/{repo}/{oid}", writing.lfs_upload),
    ("POST", "/lfs-verify/{repo}/{oid}", writing.lfs_verify),
    ("GET HEAD", "/{repo}/resolve/{revision}/{path}", reading.resolve),
    ("GET HEAD", "/{model}/resolve/{revision}/{path}", reading.resolve),
    ("GET HEAD", "/cdn/{repo}/{oid}/{path}", reading.cdn),
)
_ROUTES = [(methods.split(), _pattern(path), respond) for methods, path, respond in _ANSWERS]
