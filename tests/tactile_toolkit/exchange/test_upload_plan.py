"""What an upload decides before it does anything: which files, and in which card."""

from __future__ import annotations

import hashlib
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from starstruck_gen.generation import GenerateSpec, generate
from tactile_toolkit.exchange.upload_plan import (
    LocalFile,
    card_for_hub,
    collect,
    compare,
)
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
    blob = hashlib.sha1(b"blob %d\0" % len(content) + content).hexdigest()
    return LocalFile(path, len(content), hashlib.sha256(content).hexdigest(), blob)


def remote(path: str, content: bytes, large: bool) -> HubFile:
    file = local(path, content)
    digest = Digest("sha256", file.sha256) if large else Digest("git-sha1", str(file.git_oid))
    return HubFile(path, len(content), digest)


@given(st.dictionaries(names, contents), st.dictionaries(names, st.tuples(contents, st.booleans())))
def test_a_plan_brings_exactly_the_folder(here, there):
    plan = compare(
        [local(path, content) for path, content in here.items()],
        {path: remote(path, content, large) for path, (content, large) in there.items()},
    )
    after = {path: content for path, (content, _) in there.items()}
    after |= {file.path: here[file.path] for file in plan.to_send}
    assert {path: after[path] for path in here} == here
    for file in (*plan.kept, *plan.removed):
        del after[file.path]
    assert set(after) - set(here) <= {".gitattributes"}
    assert plan.send_bytes == sum(len(here[file.path]) for file in plan.to_send)
    assert all(there[file.path][0] == here[file.path] for file in plan.same), (
        "nothing that differs is called same"
    )
    assert not any(path in there and there[path][0] == here[path] for path in (f.path for f in plan.to_send))


def test_a_file_too_large_for_git_is_never_taken_for_a_small_one():
    big = LocalFile("data/a.parquet", 3, "0" * 64, None)
    plan = compare([big], {"data/a.parquet": HubFile("data/a.parquet", 3, Digest("git-sha1", "1" * 40))})
    assert [file.path for file in plan.changed] == ["data/a.parquet"]


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
    payload = collect(folder, manifest).with_rendered({"README.md": b"# card"})
    assert [file.path for file in sorted(payload.files, key=lambda file: file.path)] == [
        "README.md",
        "croissant.json",
        "data/test-00000-of-00001.parquet",
        "data/train-00000-of-00001.parquet",
        "manifest.json",
        "previews/scenes.png",
    ]
    assert sorted(payload.left_out) == [
        ".pending/",
        ".writing-host-1-abc-README.md",
        "notes.txt",
        "previews/.writing-host-1-abc-x.png",
        "secret/",
    ]
    card, *others = payload.files
    assert payload.content(card) == b"# card"
    assert all(payload.content(file) == folder / file.path for file in others)


def test_a_card_beside_foreign_shards_names_its_files():
    head = "configs:\n- data_files:\n  - split: train\n    path: data/train-*\n"
    card = f'---\n{head}---\nload_dataset("FOLDER")\n'
    shards = {"train": ["data/train-00000-of-00001.parquet"]}
    same = card_for_hub(card, NAME, shards, ["notes.txt", "data/test-00000-of-00001.parquet"])
    assert "path: data/train-*" in same
    mixed = card_for_hub(card, NAME, shards, ["data/train-00001-of-00002.parquet"])
    assert "path:\n    - data/train-00000-of-00001.parquet" in mixed
