"""Uploads in this process, through the unchanged client library, to the server on 127.0.0.1."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

import pytest
from huggingface_hub import constants, file_download
from huggingface_hub.utils.tqdm import disable_progress_bars, enable_progress_bars

from tactile_toolkit.hub import calls
from tests.hub_server import HubServer
from tests.tactile_toolkit.hub.client import forget_sessions

__all__ = ["logged_in"]


@contextmanager
def logged_in(server: HubServer, token: str, monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    """Let the client library talk to the server, as if HF_ENDPOINT had been set when it was imported."""
    monkeypatch.setattr(constants, "ENDPOINT", server.endpoint)
    template = server.endpoint + "/{repo_id}/resolve/{revision}/{filename}"
    for module in (constants, file_download):  # clients before 1.0 have a copy there
        monkeypatch.setattr(module, "HUGGINGFACE_CO_URL_TEMPLATE", template, raising=False)
    monkeypatch.setattr(constants, "HF_HUB_DISABLE_XET", True)
    monkeypatch.setenv("HF_TOKEN", token)
    monkeypatch.setattr(calls, "WAITS_S", (0.01, 0.02))
    forget_sessions()
    disable_progress_bars()
    try:
        yield
    finally:
        enable_progress_bars()
        forget_sessions()
