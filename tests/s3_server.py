"""An S3 server on 127.0.0.1 for tests: moto behind a layer that counts, refuses and interrupts requests."""

from __future__ import annotations

import socket
import threading
from collections import Counter
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, field
from typing import Any

KEY, SECRET = "AKIATESTONLYNOTAREALKEY", "a-secret-that-no-output-may-hold"

Environ = dict[str, Any]
Answer = tuple[str, str]


@dataclass
class Traffic:
    """Requests of clients by method, bytes that were sent to them, and keys that they wrote."""

    requests: Counter[str] = field(default_factory=Counter)
    sent_bytes: int = 0
    paths: list[str] = field(default_factory=list)

    def reset(self) -> None:
        self.requests.clear()
        self.paths.clear()
        self.sent_bytes = 0


@dataclass
class S3Server:
    """The server; ``refuse`` may answer a request itself, with a status and an error code of S3.

    ``shorten`` says after how many bytes of its body an answer ends, although its head promises more, and
    ``slow`` how many seconds each byte of it takes.
    """

    traffic: Traffic = field(default_factory=Traffic)
    stopped: threading.Event = field(default_factory=threading.Event)
    refuse: Callable[[Environ], Answer | None] = lambda _: None
    shorten: Callable[[Environ], int | None] = lambda _: None
    slow: Callable[[Environ], float] = lambda _: 0.0
    endpoint: str = ""

    def environment(self) -> dict[str, str]:
        """Return the environment variables with which a client uses this server."""
        return {
            "AWS_ENDPOINT_URL": self.endpoint,
            "AWS_ACCESS_KEY_ID": KEY,
            "AWS_SECRET_ACCESS_KEY": SECRET,
            "AWS_DEFAULT_REGION": "us-east-1",
            "AWS_EC2_METADATA_DISABLED": "true",
        }

    def objects(self, bucket: str) -> dict[str, bytes]:
        """Return all objects of a bucket, without the network."""
        from moto.s3.models import s3_backends

        keys = s3_backends["123456789012"]["global"].buckets[bucket].keys
        return {name: keys[name].value for name in sorted(keys)}

    def uploads(self, bucket: str) -> list[str]:
        """Return multipart uploads that were neither completed nor aborted."""
        from moto.s3.models import s3_backends

        return list(s3_backends["123456789012"]["global"].buckets[bucket].multiparts)

    def make_bucket(self, bucket: str) -> None:
        from moto.s3.models import s3_backends

        s3_backends["123456789012"]["global"].create_bucket(bucket, "us-east-1")

    def buckets(self) -> list[str]:
        from moto.s3.models import s3_backends

        return sorted(s3_backends["123456789012"]["global"].buckets)

    def wraps(self, app: Any) -> Callable[[Environ, Any], Iterable[bytes]]:
        """Return the application behind a layer that counts and refuses requests."""

        def call(environ: Environ, start_response: Any) -> Iterator[bytes]:
            self.traffic.requests[environ["REQUEST_METHOD"]] += 1
            self.traffic.paths.append(f"{environ['REQUEST_METHOD']} {environ['PATH_INFO']}")
            refused = self.refuse(environ)
            if refused is not None:
                status, code = refused
                body = f"<Error><Code>{code}</Code><Message>as the test wants</Message></Error>".encode()
                headers = [("Content-Type", "application/xml"), ("Content-Length", str(len(body)))]
                start_response(status, headers)
                yield b"" if environ["REQUEST_METHOD"] == "HEAD" else body
                return
            left, pause_s = self.shorten(environ), self.slow(environ)
            for piece in app(environ, start_response):
                for byte in piece if pause_s else b"":
                    self.stopped.wait(pause_s)
                    yield bytes([byte])
                if pause_s:
                    continue
                self.traffic.sent_bytes += len(piece)
                yield piece[:left]
                if left is not None:
                    environ["werkzeug.socket"].shutdown(socket.SHUT_RDWR)
                    return

        return call


def serve() -> Iterator[S3Server]:
    """Run a server until the generator is closed."""
    from moto.moto_server.werkzeug_app import create_backend_app
    from werkzeug.serving import WSGIRequestHandler, make_server

    class Quiet(WSGIRequestHandler):
        protocol_version = "HTTP/1.1"

        def log(self, *_: object, **__: object) -> None:
            pass

    server = S3Server()
    app = server.wraps(create_backend_app("s3"))
    http = make_server("127.0.0.1", 0, app, threaded=True, request_handler=Quiet)
    server.endpoint = f"http://127.0.0.1:{http.port}"
    thread = threading.Thread(target=http.serve_forever, daemon=True)
    thread.start()
    try:
        yield server
    finally:
        server.stopped.set()
        http.shutdown()
        thread.join()
        http.server_close()
