"""The HTTP side: listeners, bodies, ranges, and faults of the connection."""

from __future__ import annotations

import re
import socket
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from urllib.parse import unquote, urlsplit

from tests.hub_server.asking import Asked, Refusal, Reply
from tests.hub_server.faults import Fault, Faults, Request
from tests.hub_server.repositories import Account, Repository
from tests.hub_server.routes import answer

_PIECE = 1 << 16
_ENDLESS_PIECES = 1 << 11  # 128 MiB: a client that reads all of it fails its test, and the machine survives
_PLACE = re.compile(r".*/resolve/[^/]+/|/cdn/\w+/[^/]+/[^/]+/\w+/")


class HubServer:
    """The server with its repositories, requests, and faults that it simulates."""

    def __init__(self, root: Path | None) -> None:
        self.root = root
        self.lock = threading.RLock()
        self.repositories: dict[tuple[str, str], Repository] = {}
        self.accounts: dict[str, Account] = {}
        self.requests: list[Request] = []
        self.faults = Faults()
        self._main, self._cdn = _Listener(self), _Listener(self)

    @property
    def endpoint(self) -> str:
        """Address for ``HF_ENDPOINT``."""
        return f"http://127.0.0.1:{self._main.server_port}"

    @property
    def cdn(self) -> str:
        """Address that sends large files."""
        return f"http://127.0.0.1:{self._cdn.server_port}"

    @property
    def fetched(self) -> list[str]:
        """Paths, inside their repositories, of all file contents sent, whole or in part."""
        sent = [
            request for request in self.requests if request.method == "GET" and request.status in (200, 206)
        ]
        return [_PLACE.sub("", request.path) for request in sent if request.is_content]

    def content_requests(self, ending: str) -> list[Request]:
        """Return the GET requests for the content of a file, redirects left out."""
        return [
            request
            for request in self.requests
            if request.method == "GET"
            and request.is_content
            and request.path.endswith(ending)
            and request.status not in (301, 302, 307)
        ]

    def account(self, name: str, role: str = "write", organizations: tuple[str, ...] = ()) -> str:
        """Add an account, or a further token of one, and return the token."""
        token = f"hf_{name}{role}{len(self.accounts):04d}".replace("-", "")
        self.accounts[token] = Account(name, role, organizations)
        return token

    def create(
        self,
        name: str,
        files: dict[str, bytes] | None = None,
        *,
        kind: str = "datasets",
        private: bool = False,
        gated: str | bool = False,
    ) -> Repository:
        """Add a repository that holds some files."""
        repository = Repository(name, kind, private=private, gated=gated)
        if files:
            blobs = {path: repository.blob(path, content) for path, content in files.items()}
            repository.commit(dict(blobs), "files", author=repository.namespace)
        with self.lock:
            self.repositories[kind, name] = repository
        return repository

    def repository(self, name: str, kind: str = "datasets") -> Repository:
        """Return a repository by name, as its folder is now if it has one."""
        found = self.find(kind, name)
        if found is None:
            raise KeyError(name)
        return found

    def find(self, kind: str, name: str) -> Repository | None:
        """Return a repository by name, or None."""
        with self.lock:
            repository = self.repositories.get((kind, name))
            folder = self.root / name if self.root is not None and kind == "datasets" else None
            if folder is not None and folder.is_dir():
                if repository is None:
                    repository = self.repositories.setdefault((kind, name), Repository(name))
                repository.mirror(folder)
            return repository

    def start(self) -> None:
        """Start the server."""
        for listener in (self._main, self._cdn):
            listener.start()

    def stop(self) -> None:
        """Stop the server and free the ports."""
        self.faults.released.set()
        for listener in (self._main, self._cdn):
            listener.stop()


class _Listener(ThreadingHTTPServer):
    daemon_threads = True
    # A killed client breaks its connection; the test knows, so no traceback is printed.
    handle_error = staticmethod(lambda *_: None)  # type: ignore[assignment]

    def __init__(self, hub: HubServer) -> None:
        super().__init__(("127.0.0.1", 0), _Handler)
        self.hub = hub
        self._thread = threading.Thread(target=self._run, daemon=True)
        self._is_stopping = False

    def start(self) -> None:
        self._thread.start()

    def _run(self) -> None:
        while not self._is_stopping:
            self.handle_request()

    def stop(self) -> None:
        self._is_stopping = True
        # A last connection wakes the thread, because `serve_forever` checks for its end only every 50 ms.
        socket.create_connection(self.server_address[:2]).close()
        self._thread.join()
        self.server_close()


class _LostError(Exception):
    """The connection must be closed now."""


class _Handler(BaseHTTPRequestHandler):
    server: _Listener
    protocol_version = "HTTP/1.1"
    disable_nagle_algorithm = True  # head and body leave in two writes; the second must not wait for an ACK

    def log_message(self, *_: object) -> None:
        """Print nothing."""

    def _serve(self) -> None:
        hub = self.server.hub
        address = urlsplit(self.path)
        token = (self.headers.get("Authorization") or "").removeprefix("Bearer ")
        account = hub.accounts.get(token)
        user = account.name if account else "?" if token else None
        note = Request(self.command, unquote(address.path), address.query, self.headers.get("Range"), user)
        hub.requests.append(note)
        try:
            self._converse(Asked(hub, self.command, address, self.headers, account, bool(token)), note)
        except (_LostError, BrokenPipeError, ConnectionError):
            self.close_connection = True

    do_GET = do_HEAD = do_POST = do_PUT = do_DELETE = _serve  # noqa: N815 - names of the base class

    def _converse(self, asked: Asked, note: Request) -> None:
        hub = self.server.hub
        early = hub.faults.take(note.path, content=False)
        asked.body = b"".join(self._body_pieces())
        if early is not None and early.status is not None:
            value = {"error": f"{early.status} as told"} if early.value is None else early.value
            reply = Reply(early.status, value, early.headers)
        else:
            try:
                reply = answer(asked)
            except Refusal as refusal:
                reply = refusal.reply
        if early is not None and early.lose_reply:
            raise _LostError
        late = early if early is not None and early.drip_s is not None else None
        if reply.is_content and self.command == "GET":
            late = hub.faults.take(note.path, content=True) or late
        self._send(reply, note, late)

    def _body_pieces(self) -> Iterator[bytes]:
        if "chunked" in self.headers.get("Transfer-Encoding", ""):
            while size := int(self.rfile.readline().split(b";")[0], 16):
                yield self.rfile.read(size)
                self.rfile.readline()
            self.rfile.readline()
            return
        left = int(self.headers.get("Content-Length") or 0)
        while left and (piece := self.rfile.read(min(left, _PIECE))):
            left -= len(piece)
            yield piece

    def _send(self, reply: Reply, note: Request, fault: Fault | None) -> None:
        content = reply.content
        first, last = 0, len(content) - 1
        span = re.fullmatch(r"bytes=(\d+)-(\d*)", note.range or "") if reply.is_content else None
        if span:
            first, last = int(span[1]), min(int(span[2] or last), last)
            if first > last:
                content, reply = b"", Reply(416, {}, {"Content-Range": f"bytes */{len(content)}"})
        note.status = 206 if span and reply.status == 200 else reply.status
        self.send_response(note.status)
        for name, value in reply.headers.items():
            self.send_header(name, value)
        if note.status == 206:
            self.send_header("Content-Range", f"bytes {first}-{last}/{len(content)}")
        if fault is not None and fault.endless:
            self._send_without_end()
        self.send_header("Content-Length", str(last - first + 1 if reply.is_content else len(content)))
        drip_s = None if fault is None else fault.drip_s
        if drip_s is not None and fault is not None and fault.drips_head:
            self._drip(b"".join(self._headers_buffer), drip_s, note)
            self._headers_buffer = []
        self.end_headers()
        if drip_s is not None:
            self._drip(content[first : last + 1], drip_s, note)
            return
        if self.command != "HEAD":
            self._send_pieces(content, first, last + 1 if reply.is_content else len(content), note, fault)

    def _send_pieces(self, content: bytes, start: int, end: int, note: Request, fault: Fault | None) -> None:
        if fault is not None and fault.corrupt_at is not None:
            place = fault.corrupt_at % len(content)
            content = content[:place] + bytes([content[place] ^ 0xFF]) + content[place + 1 :]
        if fault is not None and fault.stall_after is not None:
            cut = min(end, start + fault.stall_after)
            self._write(content, start, cut, note)
            self.server.hub.faults.stalled.set()
            self.server.hub.faults.released.wait(60)
            start = cut
        self._write(content, start, end, note)

    def _send_without_end(self) -> None:
        self.send_header("Transfer-Encoding", "chunked")
        self.end_headers()
        for _ in range(_ENDLESS_PIECES):
            self.wfile.write(b"%x\r\n%s\r\n" % (_PIECE, bytes(_PIECE)))
        raise _LostError

    def _drip(self, content: bytes, pause_s: float, note: Request) -> None:
        for place in range(len(content)):
            note.sent += 1
            self.wfile.write(content[place : place + 1])
            self.wfile.flush()
            if self.server.hub.faults.released.wait(pause_s):
                raise _LostError

    def _write(self, content: bytes, start: int, end: int, note: Request) -> None:
        for place in range(start, end, _PIECE):
            piece = content[place : min(place + _PIECE, end)]
            # Counted before it is sent, so that a test that received it sees the count.
            note.sent += len(piece)
            self.wfile.write(piece)
        self.wfile.flush()


@contextmanager
def hub(root: Path | None = None) -> Iterator[HubServer]:
    """Serve repositories, and folders ``ROOT/USER/NAME`` as repositories, until the block ends."""
    server = HubServer(root)
    server.start()
    try:
        yield server
    finally:
        server.stop()
