"""A branch of the Hub stays pinned to the commit that was seen first: a real server and client."""

from __future__ import annotations

import pickle
import shutil
from pathlib import Path

import pytest

import starstruck_gen
from env_assets.provider import AssetProvider
from tests.hub_server import hub
from tests.tactile_toolkit.hub.client import as_client, settings


def write(folder: Path, seed: int, scenes: int) -> None:
    shutil.rmtree(folder, ignore_errors=True)
    spec = starstruck_gen.SceneSetSpec(scenes=(("train", scenes), ("test", scenes)), seed=seed)
    starstruck_gen.generate(spec, str(folder))


def seeds(provider: AssetProvider, split: str) -> list[int]:
    return [int(scene.seed) for scene in provider.meshes("someone/scenes", split)]


@pytest.fixture(scope="module")
def found(tmp_path_factory) -> dict[str, list[int]]:
    """Return what a client sees that opens one split before a commit and the other split after it."""
    root, home = tmp_path_factory.mktemp("hub"), tmp_path_factory.mktemp("home")
    write(root / "someone" / "scenes", seed=1, scenes=6)
    with hub(root) as server, as_client(settings(server, home)):
        provider = AssetProvider()
        by_name = AssetProvider(sources={"starstruck": "hf://datasets/someone/scenes"})
        found = {"first": seeds(provider, "train")}
        assert len(by_name.meshes("starstruck")) == len(found["first"])
        write(root / "someone" / "scenes", seed=2, scenes=9)
        copy = pickle.loads(pickle.dumps(provider))
        return found | {
            "again": seeds(provider, "train"),
            "other split": seeds(provider, "test"),
            "copy": seeds(copy, "test"),
            "by name": [int(scene.seed) for scene in by_name.meshes("starstruck", "test")],
            "new": seeds(AssetProvider(), "test"),
        }


def test_all_splits_and_copies_are_of_the_commit_that_was_seen_first_and_new_providers_see_the_new_one(found):
    assert (len(found["first"]), len(found["other split"])) == (6, 6)
    assert found["again"] == found["first"]
    assert found["by name"] == found["copy"] == found["other split"]
    assert len(found["new"]) == 9
    assert found["new"][:6] != found["other split"]


def test_an_existing_folder_is_not_a_repository(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "someone" / "scenes").mkdir(parents=True)
    provider = AssetProvider()
    for place in ("someone/scenes", "./someone/none", "/someone/none", "~/scenes/set", "scenes"):
        assert provider._commit_of(place) is None
