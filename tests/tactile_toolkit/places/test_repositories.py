"""Repositories of the Hub: the files that a card names, which of them are fetched, and use offline."""

from __future__ import annotations

import io
import json
from collections.abc import Iterator
from pathlib import Path

import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from tests.hub_server import HubServer, hub
from tests.realtouch import factories
from tests.tactile_toolkit.hub.client import run_here, settings

CARD = b"""---
configs:
- config_name: small
  data_files: [{split: train, path: 'small/train-*'}]
- config_name: large
  data_files: [{split: train, path: 'large/train-*'}]
---
"""
SMALL, LARGE = "small/train-00000-of-00001.parquet", "large/train-00000-of-00001.parquet"

OPEN = """
import json
from realtouch.kind import KIND
from tactile_toolkit.errors import ToolkitError
from tactile_toolkit.places import open_place
try:
    place = open_place({arguments})
    shards = place.require(KIND).shards()
    print(json.dumps([place.kind.name, *place.splits, sum(map(len, shards))]))
except ToolkitError as error:
    print(json.dumps([type(error).__name__, str(error)]))
"""


@pytest.fixture(scope="module")
def touches(tmp_path_factory: pytest.TempPathFactory) -> bytes:
    rows = factories.single_rows([factories.make_round(number, 3, (64, 48)) for number in range(2)])
    folder = factories.write_set(tmp_path_factory.mktemp("touches"), {"train": rows}, "single")
    (file,) = (folder / "data").iterdir()
    return file.read_bytes()


@pytest.fixture
def server(tmp_path: Path, touches: bytes) -> Iterator[HubServer]:
    with hub(tmp_path / "hub") as running:
        running.create("someone/two", {"README.md": CARD, SMALL: touches, LARGE: touches})
        running.create("someone/named", {SMALL: touches})
        yield running


def opened(server: HubServer, home: Path, arguments: str, **more: str) -> list[str]:
    done = run_here(OPEN.format(arguments=arguments), {**settings(server, home), **more}, home)
    found: list[str] = json.loads(done.stdout)
    return found


def test_one_configuration_is_opened_and_only_its_files_are_fetched(server, tmp_path):
    kind, words = opened(server, tmp_path, "'someone/two'")
    assert kind == "InputError"
    assert "has the configurations small, large; expected one of them" in words
    assert "--config-name small" in words
    assert server.fetched == ["README.md"]
    assert opened(server, tmp_path, "'someone/two', config='large'") == ["realtouch", "train", 2]
    assert server.fetched == ["README.md", LARGE]


def test_without_a_network_the_cache_answers(server, tmp_path):
    chosen = "'someone/two', config='large'"
    first = opened(server, tmp_path, chosen)
    asked = len(server.requests)
    assert opened(server, tmp_path, chosen, HF_HUB_OFFLINE="1") == first
    assert len(server.requests) == asked
    kind, words = opened(server, tmp_path, "'someone/two', config='small'", HF_HUB_OFFLINE="1")
    assert kind == "HubError"
    assert "is not in the cache" in words


def test_a_folder_of_a_repository_is_opened_by_its_address(server, tmp_path):
    assert opened(server, tmp_path, "'hf://datasets/someone/two/large'") == ["realtouch", "train", 2]
    assert server.fetched == [LARGE]


@pytest.mark.parametrize(
    "name", ["../../victim.parquet", "data/../x.parquet", "C:\\x.parquet", "con/x.parquet"]
)
def test_a_name_that_leads_out_is_refused_before_the_card_is_fetched(server, tmp_path, touches, name):
    server.create("someone/evil", {"README.md": CARD, SMALL: touches, name: touches})
    kind, words = opened(server, tmp_path, "'someone/evil', config='small'")
    assert kind == "IntegrityError"
    assert "nothing was done with it" in words
    assert server.fetched == []


def test_rows_of_another_kind_are_refused_without_a_manifest(server, tmp_path):
    table = io.BytesIO()
    vector = pa.list_(pa.list_(pa.float32(), 3))
    columns = {"id": pa.array([1]), "opening_mm": pa.array([13.0]), "mesh.vertices": pa.array([[]], vector)}
    pq.write_table(pa.table(columns), table)
    server.create("someone/wrench", {"train.parquet": table.getvalue()})
    kind, words = opened(server, tmp_path, "'someone/wrench'")
    assert kind == "InputError"
    assert "'someone/wrench' holds wrenches; `realtouch.load` is for touches; next: use env_assets" in words
