"""Fixtures of tests with an object store: one server for each worker, a new bucket for each test."""

from __future__ import annotations

import itertools
from collections.abc import Iterator

import pytest

from tests.s3_server import S3Server, serve

_NUMBERS = itertools.count()


@pytest.fixture(scope="session")
def s3_server() -> Iterator[S3Server]:
    import s3fs

    # The process caches clients, with their credentials and server.
    s3fs.S3FileSystem.clear_instance_cache()
    yield from serve()
    s3fs.S3FileSystem.clear_instance_cache()


@pytest.fixture
def new_clients() -> Iterator[None]:
    """Clients that are made in a test with its settings, and removed after it."""
    import s3fs

    s3fs.S3FileSystem.clear_instance_cache()
    yield
    s3fs.S3FileSystem.clear_instance_cache()


@pytest.fixture
def s3(s3_server: S3Server, monkeypatch: pytest.MonkeyPatch) -> S3Server:
    """The server with credentials, without any other configuration."""
    for name, value in s3_server.environment().items():
        monkeypatch.setenv(name, value)
    for name in ("AWS_PROFILE", "AWS_SESSION_TOKEN", "AWS_ENDPOINT_URL_S3"):
        monkeypatch.delenv(name, raising=False)
    s3_server.refuse = s3_server.shorten = lambda _: None
    s3_server.slow = lambda _: 0.0
    s3_server.traffic.reset()
    return s3_server


@pytest.fixture
def bucket(s3: S3Server) -> str:
    name = f"lake-{next(_NUMBERS)}"
    s3.make_bucket(name)
    return name
