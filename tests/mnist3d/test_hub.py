"""Loading from a Hub: a real server on 127.0.0.1, asked by the real client in a process of its own."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from mnist3d.generation import GenerateSpec, generate
from mnist3d.solid import SolidSpec
from mnist3d.sources.synthetic import SyntheticSource
from tests.hub_server import hub
from tests.processes import PATIENCE_S


@pytest.fixture(scope="module")
def repositories(tmp_path_factory) -> Path:
    root = tmp_path_factory.mktemp("hub")
    spec = GenerateSpec(SyntheticSource(), SolidSpec(target_vertices=500), per_class=1)
    generate(spec, str(root / "someone" / "digits"), ("test", "holdout"))
    return root


def ask(
    script: str, endpoint: str, home: Path, cwd: Path | None = None, **more: str
) -> subprocess.CompletedProcess[str]:
    """Run a script against the server: the endpoint is read when the client is imported."""
    environment = {
        **os.environ,
        "HF_ENDPOINT": endpoint,
        "HF_HOME": str(home),
        "HF_HUB_DISABLE_XET": "1",
        **more,
    }
    return subprocess.run(
        [sys.executable, "-c", script],
        capture_output=True,
        text=True,
        check=False,
        env=environment,
        cwd=cwd,
        timeout=PATIENCE_S,
    )


LOAD = """
import mnist3d
digits = list(mnist3d.load('someone/digits', {arguments}))
print(len(digits), sum(digit.volume_m3 for digit in digits))
"""


def test_only_the_shards_of_the_split_are_fetched(repositories, tmp_path):
    with hub(repositories) as server:
        done = ask(LOAD.format(arguments="'test'"), server.endpoint, tmp_path)
        assert done.returncode == 0, done.stderr
        assert done.stdout.startswith("10 ")
        assert server.fetched == ["manifest.json", "data/test-00000-of-00001.parquet"]
        again = ask(LOAD.format(arguments="'test', revision='main'"), server.endpoint, tmp_path)
        assert again.stdout == done.stdout
        assert len(server.fetched) == 2, "a file in the cache was fetched again"
        endpoint = server.endpoint
    offline = ask(LOAD.format(arguments="'test'"), endpoint, tmp_path, HF_HUB_OFFLINE="1")
    assert offline.stdout == done.stdout, offline.stderr
    unreachable = ask(LOAD.format(arguments="'test'"), endpoint, tmp_path)
    assert unreachable.stdout == done.stdout, unreachable.stderr


def test_streaming_stores_nothing(repositories, tmp_path):
    with hub(repositories) as server:
        done = ask(LOAD.format(arguments="'holdout', streaming=True"), server.endpoint, tmp_path)
    assert done.returncode == 0, done.stderr
    assert done.stdout.startswith("10 ")
    assert not list(tmp_path.rglob("*.parquet"))


CATCH = """
import mnist3d
from tactile_toolkit.errors import ToolkitError
try:
    mnist3d.load({arguments})
except ToolkitError as error:
    print(error.exit_code, type(error).__name__, error)
"""


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        ("'someone/nothing', 'test'", ("4 HubError", "'someone/nothing' was not found", "hf auth login")),
        ("'someone/digits', 'test', revision='v9'", ("4 HubError", "no revision 'v9'")),
        ("'someone/digits', 'train'", ("2 InputError", "no split 'train'", "holdout, test")),
    ],
)
def test_failures_are_named(repositories, tmp_path, arguments, words):
    with hub(repositories) as server:
        done = ask(CATCH.format(arguments=arguments), server.endpoint, tmp_path)
    for word in words:
        assert word in done.stdout, done.stdout + done.stderr


def test_no_network_is_named(tmp_path):
    done = ask(CATCH.format(arguments="'someone/digits', 'test'"), "http://127.0.0.1:9", tmp_path)
    assert "4 HubError" in done.stdout, done.stdout + done.stderr
    offline = ask(
        CATCH.format(arguments="'someone/digits', 'test'"), "http://127.0.0.1:9", tmp_path, HF_HUB_OFFLINE="1"
    )
    assert "4 HubError" in offline.stdout
    assert "not in the cache" in offline.stdout


def test_the_published_set_by_its_short_name(repositories, tmp_path):
    published = tmp_path / "root" / "TimSchneider42" / "tactile-mnist-mnist3d"
    shutil.copytree(repositories / "someone" / "digits", published)
    script = LOAD.replace("someone/digits", "mnist3d").format(arguments="'test'")
    with hub(tmp_path / "root") as server:
        from_hub = ask(script, server.endpoint, tmp_path / "hf", cwd=tmp_path)
        assert from_hub.stdout.startswith("10 "), from_hub.stderr
        fetched = len(server.fetched)
        shutil.copytree(published, tmp_path / "mnist3d")
        local = ask(script, server.endpoint, tmp_path / "hf", cwd=tmp_path)
        assert local.stdout == from_hub.stdout
        assert len(server.fetched) == fetched, "a folder of that name comes first"
