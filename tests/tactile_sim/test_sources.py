"""Sources of touches: the files and objects that a manifest names."""

from __future__ import annotations

import json
import shutil
from pathlib import Path

import pyarrow as pa
import pyarrow.parquet as pq
import pytest

import tactile_sim
from tactile_sim.sets.pairs import make_pairs
from tactile_sim.sets.set_options import PairSetSpec
from tests.command_line import call

pytestmark = pytest.mark.sim
SPEC = tactile_sim.TouchSetSpec(
    (32, 24), "depth", plan=tactile_sim.TouchPlan(4, 8, "object", seed=3), image_format="png"
)


@pytest.fixture(scope="module")
def touches(scenes, tmp_path_factory):
    folder = tmp_path_factory.mktemp("touches") / "set"
    tactile_sim.generate(scenes, SPEC, folder, ["train"])
    return folder


@pytest.fixture(scope="module")
def with_an_open_mesh(scenes, tmp_path_factory):
    """The scenes, one of which lacks a face, so that it does not bound a solid."""
    folder = tmp_path_factory.mktemp("open") / "scenes"
    (folder / "data").mkdir(parents=True)
    (file,) = (scenes / "data").glob("train-*")
    table = pq.read_table(file)
    faces = table["mesh.faces"].to_pylist()
    faces[1] = faces[1][1:]
    place = table.schema.get_field_index("mesh.faces")
    field = table.schema.field(place)
    changed = table.set_column(place, field, pa.array(faces, field.type))
    pq.write_table(changed, folder / "data" / file.name)
    return folder


def _manifest(folder: Path) -> dict:
    return json.loads((folder / "manifest.json").read_text())


def test_equal_pairs_have_equal_manifests_that_name_no_place(scenes, touches, tmp_path):
    made = []
    for name in ("one", "other"):
        # Copies have other folders, inodes and times.
        here = tmp_path / name
        shutil.copytree(scenes, here / "scenes")
        shutil.copytree(touches, here / "touches")
        make_pairs(
            str(here / "scenes"), str(here / "touches"), "train", PairSetSpec((32, 24), 10), here / "pairs"
        )
        made.append({f.name: f.read_bytes() for f in (here / "pairs").iterdir() if f.is_file()})
    assert made[0] == made[1]
    assert not any(str(tmp_path).encode() in content for content in made[0].values())
    source = _manifest(tmp_path / "one" / "pairs")["spec"]["source"]
    assert [len(each["sha256"]) for each in source["depth"]] == [64]
    assert [each["file"] for each in source["real"]] == ["train-00000-of-00001.parquet"]
    # Other touches with the same name and shape are another source.
    tactile_sim.generate(
        scenes,
        tactile_sim.TouchSetSpec((32, 24), "depth", plan=tactile_sim.TouchPlan(4, 8, "object", seed=4)),
        tmp_path / "others",
        ["train"],
    )
    make_pairs(str(scenes), str(tmp_path / "others"), "train", PairSetSpec((32, 24), 10), tmp_path / "more")
    assert _manifest(tmp_path / "more")["spec"]["source"]["real"] != source["real"]


def test_an_object_in_two_shards_is_left_out_once(with_an_open_mesh, touches, tmp_path, monkeypatch, capsys):
    monkeypatch.setattr("tactile_sim.sets.generation._SHARD_BYTES", 1)
    monkeypatch.setattr("tactile_sim.sets.pairs._ROWS_PER_SHARD", 3)
    tactile_sim.generate(with_an_open_mesh, SPEC, tmp_path / "touches")
    make_pairs(
        str(with_an_open_mesh), str(touches), "train", PairSetSpec((32, 24), 12, 0.0), tmp_path / "pairs"
    )
    assert len(_manifest(tmp_path / "touches")["shards"]) > 3
    for folder, split in ((tmp_path / "touches", "train"), (tmp_path / "pairs", "depth")):
        manifest = _manifest(folder)
        skipped = [item["id"] for shard in manifest["shards"] for item in shard["skipped"]]
        assert skipped == [1]
        assert manifest["splits"][split]["skipped"] == 1
        assert "left out | 1" in (folder / "README.md").read_text()
    assert call("tactile", "info", tmp_path / "touches", "--json") == 0
    assert json.loads(capsys.readouterr().out)["splits"]["train"]["skipped"] == 1
