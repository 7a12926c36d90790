from __future__ import annotations

import re
import shlex
import shutil
from pathlib import Path

import pytest

import env_assets
from env_assets.provider import meshes_at
from tactile_toolkit.errors import InputError, SpecMismatchError
from tactile_toolkit.store import open_folder, read_manifest
from tests.command_line import call
from tests.env_assets.factories import write_meshes
from tests.env_assets.shapes import box
from tests.forked import start_forked


def run_named_command(message: str) -> None:
    """Return the command line in a message."""
    command = re.search(r"next: run `([^`]+)`", message)
    assert command, message
    assert call(*shlex.split(command[1]), "--quiet") == 0


def parquet(folder: Path) -> dict[str, bytes]:
    return {file.name: file.read_bytes() for file in sorted((folder / "data").glob("*.parquet"))}


@pytest.mark.one_at_a_desk
@pytest.mark.parametrize(
    ("kind", "split", "rows"), [("mnist3d", "holdout", 10), ("starstruck", "test", 3), ("wrench", "train", 1)]
)
def test_the_command_in_the_message_makes_the_missing_data(tmp_path, kind, split, rows):
    """With generate=True, the same data are made, byte for byte."""
    root = tmp_path / "some assets"
    options = {"per_class": 1, "seed": 3}
    with pytest.raises(
        InputError, match=f"no split '{split}' of '{kind}' in .*: it does not exist"
    ) as caught:
        env_assets.AssetProvider(root, **options).meshes(kind, split)
    assert not root.exists()
    run_named_command(str(caught.value))
    assert len(env_assets.AssetProvider(root, **options).meshes(kind, split)) == rows
    made = env_assets.AssetProvider(tmp_path / "made", generate=True, **options)
    assert len(made.meshes(kind, split)) == rows
    assert parquet(tmp_path / "made" / kind) == parquet(root / kind)


def test_splits_are_added_one_by_one_and_named_where_one_is_missing(tmp_path):
    made = env_assets.AssetProvider(tmp_path, generate=True, per_class=2)
    assert len(made.meshes("starstruck", "test")) == 6
    with pytest.raises(
        InputError, match=r"no split 'train' in .*: it has test; next: run `starstruck generate"
    ):
        env_assets.AssetProvider(tmp_path, per_class=2).meshes("starstruck", "train")
    assert len(made.meshes("starstruck", "train")) == 6
    manifest = read_manifest(open_folder(str(tmp_path / "starstruck")))
    assert (manifest.splits, manifest.complete) == (("train", "test"), True)


def test_unknown_splits_are_refused_and_nothing_is_made(tmp_path):
    provider = env_assets.AssetProvider(tmp_path, generate=True, per_class=1)
    for kind, split in (("mnist3d", "trian"), ("starstruck", "holdout"), ("wrench", "test")):
        with pytest.raises(InputError, match=f"unknown split '{split}'"):
            provider.meshes(kind, split)
    assert not list(tmp_path.iterdir()), "no lock either"
    for kind, split in (("mnist3d", "trian"), ("starstruck", "holdout"), ("wrench", "test")):
        with pytest.raises(InputError, match=f"unknown split '{split}' of {kind}; expected one of"):
            env_assets.AssetProvider(tmp_path).meshes(kind, split)


def test_a_set_made_otherwise_is_left_alone(tmp_path):
    env_assets.AssetProvider(tmp_path, generate=True, per_class=1).meshes("starstruck", "test")
    before = parquet(tmp_path / "starstruck")
    with pytest.raises(SpecMismatchError, match=r"scenes\.train is 3 there, 6 was asked for"):
        env_assets.AssetProvider(tmp_path, generate=True, per_class=2).meshes("starstruck", "train")
    assert parquet(tmp_path / "starstruck") == before


def test_only_known_kinds_are_made(tmp_path):
    with pytest.raises(InputError, match="does not exist; expected a folder, a Parquet file"):
        env_assets.AssetProvider(tmp_path, generate=True).meshes("screwdriver")
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("options", [{"seed": -1}, {"per_class": 0}, {"per_class": 1.5}, {"workers": 0}])
def test_numbers_without_any_object_are_refused_at_once(tmp_path, options):
    (name,) = options
    with pytest.raises(InputError, match=f"{name} of the AssetProvider is"):
        env_assets.AssetProvider(tmp_path, **options)


def _make(folder: str, split: str) -> list[int]:
    provider = env_assets.AssetProvider(folder, generate=True, per_class=30)
    return provider.meshes("starstruck", split).ids.tolist()


def test_processes_that_start_at_once_do_not_harm_each_other(tmp_path):
    """Two processes make the same split and one another split; without locks, a split would be lost."""
    splits = ("test", "train", "train")
    running = [start_forked(_make, str(tmp_path), split) for split in splits]
    assert [process.end() for process in running] == [0] * 3, [process.err for process in running]
    again = env_assets.AssetProvider(tmp_path)
    for split, process in zip(splits, running, strict=True):
        assert str(again.meshes("starstruck", split).ids.tolist()) in process.out
    manifest = read_manifest(open_folder(str(tmp_path / "starstruck")))
    assert (manifest.splits, manifest.complete) == (("train", "test"), True)
    assert not list((tmp_path / "starstruck").rglob(".writing-*"))


def test_a_split_that_cannot_be_added_is_made_in_another_folder(tmp_path):
    """The set was made with other options, which the command of the message would not repeat."""
    assert (
        call(
            "starstruck", "generate", "--scenes", "30", "--split", "train", "--out", tmp_path / "a/starstruck"
        )
        == 0
    )
    with pytest.raises(InputError, match="add the split as the others were made") as caught:
        env_assets.AssetProvider(tmp_path / "a").meshes("starstruck", "test")
    run_named_command(str(caught.value))
    assert len(env_assets.AssetProvider(tmp_path / "a-test").meshes("starstruck", "test")) == 300


def test_environments_get_the_kind_that_they_need(assets, tmp_path):
    shutil.copytree(assets / "mnist3d", tmp_path / "own" / "mnist3d")
    with pytest.raises(InputError, match=r"no split 'test' of 'starstruck'.*next: run `starstruck generate"):
        meshes_at(tmp_path / "own", "test", needed="starstruck")
    for needed, nouns in (("starstruck", "scenes"), ("wrench", "wrenches")):
        with pytest.raises(InputError, match=f"was expected to hold {nouns}, found digits"):
            meshes_at(tmp_path / "own" / "mnist3d", "test", needed=needed)
    assert len(meshes_at(tmp_path / "own", "test", needed="mnist3d")) == len(
        meshes_at(tmp_path / "own" / "mnist3d", "test", needed="mnist3d")
    )
    # Meshes of no kind of the toolkit, and kinds that it does not make, may be anything.
    write_meshes(tmp_path / "boxes", [box((0, 0, 0), (1, 1, 1)).to_trimesh()], ("box",))
    for source, needed in (("boxes", "starstruck"), ("boxes", "abc"), ("own/mnist3d", "abc")):
        assert len(meshes_at(tmp_path / source, "test" if "own" in source else "train", needed=needed))
