"""The Hub that uploads go to; tests of downloads have servers of their own."""

from __future__ import annotations

from collections.abc import Iterator

import pytest

from tests.hub_server import HubServer, hub
from tests.tactile_toolkit.exchange.upload_client import logged_in


@pytest.fixture
def server(monkeypatch: pytest.MonkeyPatch) -> Iterator[HubServer]:
    with hub() as running, logged_in(running, running.account("someone"), monkeypatch):
        yield running
