"""A Hub on 127.0.0.1 that serves data set repositories from a folder: enough of it to list, head and fetch.

``ROOT/USER/NAME/...`` are the files of repository ``USER/NAME``. Every file sent is noted, so that tests can
say what was fetched and what was not.
"""

from __future__ import annotations

import hashlib
import json
import re
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from urllib.parse import unquote, urlsplit

COMMIT = "0123456789abcdef0123456789abcdef01234567"

_TREE = re.compile(r"/api/datasets/(?P<repo>[^/]+/[^/]+)/tree/(?P<revision>[^/]+)/?(?P<path>.*)")
_INFO = re.compile(r"/api/datasets/(?P<repo>[^/]+/[^/]+)(/revision/(?P<revision>[^/]+))?")
_FILE = re.compile(r"/datasets/(?P<repo>[^/]+/[^/]+)/resolve/(?P<revision>[^/]+)/(?P<path>.+)")


class HubServer(ThreadingHTTPServer):
    """The server and what it was asked."""

    daemon_threads = True

    def __init__(self, root: Path) -> None:
        super().__init__(("127.0.0.1", 0), _Handler)
        self.root = root
        self.fetched: list[str] = []

    @property
    def endpoint(self) -> str:
        """Address for ``HF_ENDPOINT``."""
        return f"http://127.0.0.1:{self.server_port}"


class _Handler(BaseHTTPRequestHandler):
    server: HubServer
    protocol_version = "HTTP/1.1"

    def log_message(self, *_: object) -> None:
        """Say nothing."""

    def do_HEAD(self) -> None:
        self._answer(body=False)

    def do_GET(self) -> None:
        self._answer(body=True)

    def _answer(self, *, body: bool) -> None:
        path = unquote(urlsplit(self.path).path)
        for pattern, answer in ((_TREE, self._tree), (_FILE, self._file), (_INFO, self._info)):
            match = pattern.fullmatch(path)
            if match:
                repo = self.server.root / match["repo"]
                if not repo.is_dir():
                    return self._send(b'{"error": "not found"}', 404, {"X-Error-Code": "RepoNotFound"}, body)
                if match["revision"] not in (None, "main", COMMIT):
                    return self._send(b"{}", 404, {"X-Error-Code": "RevisionNotFound"}, body)
                return answer(repo, match, body)
        return self._send(b"{}", 404, {}, body)

    def _tree(self, repo: Path, match: re.Match[str], body: bool) -> None:
        files = [f for f in sorted((repo / match["path"]).rglob("*")) if f.is_file()]
        entries = [
            {"type": "file", "path": str(f.relative_to(repo)), "size": f.stat().st_size, "oid": _etag(f)}
            for f in files
        ]
        self._send(json.dumps(entries).encode(), 200, {"Content-Type": "application/json"}, body)

    def _info(self, repo: Path, match: re.Match[str], body: bool) -> None:
        siblings = [{"rfilename": str(f.relative_to(repo))} for f in sorted(repo.rglob("*")) if f.is_file()]
        info = {
            "id": match["repo"],
            "sha": COMMIT,
            "siblings": siblings,
            "private": False,
            "tags": [],
            "downloads": 0,
        }
        self._send(json.dumps(info).encode(), 200, {"Content-Type": "application/json"}, body)

    def _file(self, repo: Path, match: re.Match[str], body: bool) -> None:
        file = repo / match["path"]
        if not file.is_file():
            return self._send(b"", 404, {"X-Error-Code": "EntryNotFound"}, body)
        content = file.read_bytes()
        if body:
            self.server.fetched.append(match["path"])
        headers = {"X-Repo-Commit": COMMIT, "ETag": f'"{_etag(file)}"', "Accept-Ranges": "bytes"}
        span = re.fullmatch(r"bytes=(\d+)-(\d*)", self.headers.get("Range") or "")
        if span and body:
            first, last = int(span[1]), int(span[2] or len(content) - 1)
            headers["Content-Range"] = f"bytes {first}-{last}/{len(content)}"
            return self._send(content[first : last + 1], 206, headers, body)
        return self._send(content, 200, headers, body)

    def _send(self, content: bytes, status: int, headers: dict[str, str], body: bool) -> None:
        self.send_response(status)
        for name, value in headers.items():
            self.send_header(name, value)
        self.send_header("Content-Length", str(len(content)))
        self.end_headers()
        if body:
            self.wfile.write(content)


def _etag(file: Path) -> str:
    return hashlib.sha1(file.read_bytes()).hexdigest()


@contextmanager
def hub(root: Path) -> Iterator[HubServer]:
    """Serve a folder of repositories until the block ends."""
    server = HubServer(root)
    thread = threading.Thread(target=server.serve_forever, daemon=True)
    thread.start()
    try:
        yield server
    finally:
        server.shutdown()
        server.server_close()
        thread.join()
