"""The Hub that these tests read from."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import pytest

from tests.hub_server import HubServer
from tests.tactile_toolkit.hub.sets import two_sets


@pytest.fixture
def server(tmp_path: Path) -> Iterator[HubServer]:
    with two_sets(tmp_path / "root") as running:
        yield running
