"""Plans of uploads, before anything is sent: files, and the card."""

from __future__ import annotations

import hashlib
from pathlib import Path
from tempfile import TemporaryDirectory

import pytest
from hypothesis import given, strategies as st

from starstruck_gen.scene_dataset import SceneSetSpec, generate
from tactile_toolkit.cards import FolderSummary
from tactile_toolkit.cards.yaml_head import configs
from tactile_toolkit.exchange.upload import LocalFile, collect, compare
from tactile_toolkit.hub import HubRepository
from tactile_toolkit.store import open_folder, read_manifest
from tactile_toolkit.store.verification import HubFile


@pytest.fixture
def folder(tmp_path) -> Path:
    """Two splits of scenes."""
    place = tmp_path / "stars"
    generate(SceneSetSpec(scenes=(("train", 9), ("test", 3))), str(place))
    return place


names = st.sampled_from(["README.md", "data/a.parquet", "data/b.parquet", "manifest.json", ".gitattributes"])
contents = st.sampled_from([b"", b"one", b"two", b"three"])


def digest(content: bytes, *, large: bool) -> str:
    if large:
        return hashlib.sha256(content).hexdigest()
    return hashlib.sha1(b"blob %d\0" % len(content) + content).hexdigest()


@given(
    st.dictionaries(names, st.tuples(contents, st.booleans())),
    st.dictionaries(names, st.tuples(contents, st.booleans())),
)
def test_a_plan_reproduces_exactly_the_folder(here, there):
    with TemporaryDirectory() as folder:
        files = []
        for number, (path, (content, is_known)) in enumerate(here.items()):
            place = Path(folder, str(number))
            place.write_bytes(content)
            sha256 = digest(content, large=True) if is_known else None
            files.append(LocalFile(path, place, len(content), sha256))
        held = {
            path: HubFile(path, len(content), digest(content, large=large))
            for path, (content, large) in there.items()
        }
        plan = compare(files, HubRepository("a/b", None, "0" * 40, held))
    after = {path: content for path, (content, _) in there.items()}
    after |= {file.path: here[file.path][0] for file in plan.to_send}
    assert {path: after[path] for path in here} == {path: content for path, (content, _) in here.items()}
    for path in (*plan.kept, *plan.removed):
        del after[path]
    assert set(after) - set(here) <= {".gitattributes"}
    sent = (file.path for file in plan.to_send)
    assert not any(path in there and there[path][0] == here[path][0] for path in sent)


def test_only_the_data_set_is_sent(folder):
    (folder / ".pending").mkdir()
    (folder / ".pending" / "train-00000-of-00001.json").write_text("{}")
    (folder / ".writing-host-1-abc-README.md").write_text("half")
    (folder / "previews" / ".writing-host-1-abc-x.png").write_text("half")
    (folder / "data" / ".writing-otherhost-17.3-0123abcd-train-00000-of-00003.parquet").write_text("half")
    (folder / "notes.txt").write_text("mine")
    (folder / "secret").mkdir()
    (folder / "secret" / "token").write_text("hf_secret")
    manifest = read_manifest(open_folder(str(folder)))
    assert manifest is not None
    assert sorted(collect(folder, manifest)) == [
        *("README.md", "data/test-00000-of-00001.parquet", "data/train-00000-of-00001.parquet"),
        *("manifest.json", "previews/scenes.png"),
    ]


def test_shards_beside_foreign_ones_are_named(folder):
    facts = FolderSummary.of(open_folder(str(folder)))
    assert [entry["path"] for entry in configs(facts, ["notes.txt"])[0]["data_files"]] == [
        "data/train-*",
        "data/test-*",
    ]
    mixed = configs(facts, ["data/train-00001-of-00002.parquet"])[0]["data_files"]
    assert [entry["path"] for entry in mixed] == [["data/train-00000-of-00001.parquet"], "data/test-*"]
