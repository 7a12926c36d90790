"""Loading from a Hub: a real server on 127.0.0.1, asked by the real client."""

from __future__ import annotations

import shutil
from pathlib import Path

import pytest

from tests.hub_server import hub
from tests.tactile_toolkit.hub.client import run_here, settings


@pytest.fixture(scope="module")
def repositories(digits_set, tmp_path_factory) -> Path:
    root = tmp_path_factory.mktemp("hub")
    shutil.copytree(digits_set, root / "someone" / "digits")
    return root


LOAD = """
import mnist3d
digits = list(mnist3d.load('someone/digits', {arguments}))
print(len(digits), sum(digit.volume_m3 for digit in digits))
"""


def test_only_the_shards_of_the_split_are_fetched(repositories, tmp_path):
    script = LOAD.format(arguments="'test'")
    with hub(repositories) as server:
        done = run_here(script, settings(server, tmp_path), tmp_path)
        assert done.stdout.startswith("10 ")
        assert server.fetched == ["manifest.json", "data/test-00000-of-00001.parquet"]
        named = LOAD.format(arguments="'test', revision='main'")
        again = run_here(named, settings(server, tmp_path), tmp_path)
        assert again.stdout == done.stdout
        assert len(server.fetched) == 2, "a file in the cache was fetched again"
        endpoint = server.endpoint
    for more in ({"HF_HUB_OFFLINE": "1"}, {}):
        there = run_here(script, settings(endpoint, tmp_path, **more), tmp_path)
        assert there.stdout == done.stdout, more


def test_streaming_stores_nothing(repositories, tmp_path):
    with hub(repositories) as server:
        script = LOAD.format(arguments="'holdout', streaming=True")
        done = run_here(script, settings(server, tmp_path), tmp_path)
    assert done.stdout.startswith("10 ")
    assert not list(tmp_path.rglob("*.parquet"))


def test_the_published_set_by_its_short_name(repositories, tmp_path):
    published = tmp_path / "root" / "TimSchneider42" / "tactile-mnist-mnist3d"
    shutil.copytree(repositories / "someone" / "digits", published)
    script = LOAD.replace("someone/digits", "mnist3d").format(arguments="'test'")
    with hub(tmp_path / "root") as server:
        from_hub = run_here(script, settings(server, tmp_path), tmp_path)
        assert from_hub.stdout.startswith("10 "), from_hub.stderr
        fetched = len(server.fetched)
        shutil.copytree(published, tmp_path / "mnist3d")
        local = run_here(script, settings(server, tmp_path), tmp_path)
        assert local.stdout == from_hub.stdout
        assert len(server.fetched) == fetched, "a folder of that name comes first"
