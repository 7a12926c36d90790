"""What an upload decides before it does anything: which files, and in which card."""

from __future__ import annotations

import hashlib
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from starstruck_gen.make import GenerateSpec, generate
from tactile_toolkit.exchange.upload import LocalFile, card_for_hub, collect, compare, left_out
from tactile_toolkit.store.folder import DataFolder
from tactile_toolkit.store.manifest import read_manifest
from tactile_toolkit.store.origin import Digest, HubFile

NAME = "someone/stars"


@pytest.fixture
def folder(tmp_path) -> Path:
    """Two splits of scenes."""
    place = tmp_path / "stars"
    generate(GenerateSpec(scenes=(("train", 9), ("test", 3))), str(place))
    return place


names = st.sampled_from(["README.md", "data/a.parquet", "data/b.parquet", "manifest.json", ".gitattributes"])
contents = st.sampled_from([b"", b"one", b"two", b"three"])


def local(path: str, content: bytes) -> LocalFile:
    blob = Digest("git-sha1", hashlib.sha1(b"blob %d\0" % len(content) + content).hexdigest())
    sha256 = Digest("sha256", hashlib.sha256(content).hexdigest())
    return LocalFile(path, Path("not looked at"), len(content), (sha256, blob))


def remote(path: str, content: bytes, large: bool) -> HubFile:
    sha256, blob = local(path, content).digests
    return HubFile(path, len(content), sha256 if large else blob)


@given(st.dictionaries(names, contents), st.dictionaries(names, st.tuples(contents, st.booleans())))
def test_a_plan_brings_exactly_the_folder(here, there):
    plan = compare(
        [local(path, content) for path, content in here.items()],
        {path: remote(path, content, large) for path, (content, large) in there.items()},
    )
    after = {path: content for path, (content, _) in there.items()}
    after |= {file.path: here[file.path] for file in plan.to_send}
    assert {path: after[path] for path in here} == here
    for path in (*plan.kept, *plan.removed):
        del after[path]
    assert set(after) - set(here) <= {".gitattributes"}
    assert not any(path in there and there[path][0] == here[path] for path in (f.path for f in plan.to_send))


def test_a_file_too_large_for_git_is_never_taken_for_a_small_one():
    big = LocalFile("data/a.parquet", Path("a"), 3, (Digest("sha256", "0" * 64),))
    plan = compare([big], {"data/a.parquet": HubFile("data/a.parquet", 3, Digest("git-sha1", "1" * 40))})
    assert [file.path for file in plan.to_send] == ["data/a.parquet"]


def test_a_file_is_known_by_its_content(tmp_path):
    (tmp_path / "a").write_bytes(b"one")
    assert LocalFile.of("a", tmp_path / "a").digests == local("a", b"one").digests


def test_the_payload_is_the_data_set_and_nothing_else(folder):
    (folder / ".pending").mkdir()
    (folder / ".pending" / "train-00000-of-00001.json").write_text("{}")
    (folder / ".writing-host-1-abc-README.md").write_text("half")
    (folder / "previews" / ".writing-host-1-abc-x.png").write_text("half")
    (folder / "notes.txt").write_text("mine")
    (folder / "secret").mkdir()
    (folder / "secret" / "token").write_text("hf_secret")
    manifest = read_manifest(DataFolder(str(folder)))
    assert manifest is not None
    files = collect(folder, manifest)
    assert sorted(file.path for file in files) == [
        "README.md",
        "croissant.json",
        "data/test-00000-of-00001.parquet",
        "data/train-00000-of-00001.parquet",
        "manifest.json",
        "previews/scenes.png",
    ]
    assert sorted(left_out(folder, (file.path for file in files))) == [
        ".pending/",
        ".writing-host-1-abc-README.md",
        "notes.txt",
        "secret/",
    ]
    assert all(file.place == folder / file.path for file in files)


def test_a_card_beside_foreign_shards_names_its_files():
    head = "configs:\n- data_files:\n  - split: train\n    path: data/train-*\n"
    card = f'---\n{head}---\nload_dataset("FOLDER")\n'
    shards = {"train": ["data/train-00000-of-00001.parquet"]}
    same = card_for_hub(card, NAME, shards, ["notes.txt", "data/test-00000-of-00001.parquet"])
    assert "path: data/train-*" in same
    mixed = card_for_hub(card, NAME, shards, ["data/train-00001-of-00002.parquet"])
    assert "path:\n    - data/train-00000-of-00001.parquet" in mixed
