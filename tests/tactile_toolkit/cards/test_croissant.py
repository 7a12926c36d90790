"""``croissant.json`` is what ``mlcroissant`` itself reads: valid, true of the folder, with the real rows."""

from __future__ import annotations

import io
import json
from dataclasses import replace
from pathlib import Path

import msgspec
import numpy as np
import pyarrow.parquet as pq
import pytest
import trimesh
import yaml

import mnist3d
import realtouch
import starstruck_gen
from tactile_toolkit.cards.card import check_card
from tactile_toolkit.cards.facts import croissant_again, croissant_text, folder_facts
from tactile_toolkit.store.folder import DataFolder
from tactile_toolkit.store.manifest import read_manifest
from tactile_toolkit.store.shards import ShardName
from tests.command_line import call
from tests.realtouch.factories import make_round, seq_rows, single_rows, write_set

mlc = pytest.importorskip("mlcroissant")

# Of the reader's own making.
pytestmark = [
    pytest.mark.filterwarnings("ignore::DeprecationWarning:rdflib"),
    pytest.mark.filterwarnings("ignore:The inplace keyword"),
]

RAI = "http://mlcommons.org/croissant/RAI/1.0"


def loaded(folder: Path, **options: object):
    """Open a folder as a foreign reader does, and let no complaint of his pass but that there is no date."""
    found = mlc.Dataset(str(folder / "croissant.json"), **options)
    assert not found.metadata.ctx.issues.errors
    (warning,) = found.metadata.ctx.issues.warnings
    assert "datePublished" in warning, "nothing in a folder depends on when it was made"
    return found


def test_records_are_the_rows(made):
    found = loaded(made)
    for split in ("test", "holdout"):
        (described,) = (each for each in found.metadata.record_sets if each.id == split)
        assert described.key == [f"{split}/id"]
        records, rows = list(found.records(split)), mnist3d.load(str(made), split=split)
        assert [record[f"{split}/id"] for record in records] == [row.id for row in rows]
        assert [record[f"{split}/label"] for record in records] == [row.label for row in rows]
        for record, row in zip(records, rows, strict=True):
            assert np.array_equal(record[f"{split}/mesh.vertices"], row.vertices_m.astype(np.float32))
            assert record[f"{split}/volume_m3"] == pytest.approx(row.volume_m3)


def test_records_of_scenes_and_of_tables(tmp_path):
    """Structs in lists, and meshes as files."""
    scenes, tables = tmp_path / "scenes", tmp_path / "tables"
    starstruck_gen.generate(starstruck_gen.GenerateSpec(scenes=(("train", 3),)), scenes, ["train"])
    assert call("starstruck", "export", scenes, "--format", "flat", "--out", tables, "-q") == 0
    rows = starstruck_gen.load(scenes, "train")
    for folder in (scenes, tables):
        for record, row in zip(loaded(folder).records("train"), rows, strict=True):
            assert record["train/id"] == row.id
            found = [
                (each["train/placements/shape"].decode(), each["train/placements/x_m"])
                for each in record["train/placements"]
            ]
            assert found == [(each.shape, each.x_m) for each in row.placements]
    for record, row in zip(loaded(tables).records("train"), rows, strict=True):
        mesh = trimesh.load_mesh(io.BytesIO(record["train/mesh"]), file_type="glb")
        assert mesh.volume == pytest.approx(row.mesh.volume, rel=1e-6)


def test_it_says_what_the_card_and_the_manifest_say(made):
    metadata = loaded(made).metadata
    assert metadata.name == "MNIST 3D"
    assert metadata.license == ["https://spdx.org/licenses/MIT.html"]
    assert "schneider2025tactilemnist" in metadata.cite_as
    assert RAI in metadata.conforms_to
    written = json.loads((made / "croissant.json").read_text())
    (described,) = (each for each in written["recordSet"] if each["@id"] == "test")
    shapes = {field["@id"]: field.get("arrayShape") for field in described["field"]}
    assert shapes["test/mesh.vertices"] == shapes["test/mesh.faces"] == "-1,3"
    assert shapes["test/volume_m3"] is None
    card = (made / "README.md").read_text()
    assert len(metadata.data_limitations) >= 4
    assert all(line in card.replace("`", "") for line in metadata.data_limitations)
    assert "seed 0" in metadata.data_collection
    assert metadata.file_objects == [], "what proves the files is the manifest"


def test_every_kind_of_touches_is_read(tmp_path):
    rounds = [make_round(index, 3, (64, 48), (12, 16)) for index in range(2)]
    clips = str(write_set(tmp_path / "clips", {"train": seq_rows(rounds)}, "seq"))
    images = str(write_set(tmp_path / "images", {"train": single_rows(rounds)}, "single"))
    realtouch.resize(clips, tmp_path / "small-clips", width=48, height=36)
    realtouch.clips_to_images(clips, tmp_path / "single", frame="peak")
    realtouch.select(images, tmp_path / "selected", contact=True)
    realtouch.frames(clips, tmp_path / "frames")
    for name in ("small-clips", "single", "selected", "frames"):
        records = list(loaded(tmp_path / name).records("train"))
        table = pq.read_table(next((tmp_path / name / "data").iterdir()))
        assert len(records) == len(table)
        assert {key.partition("/")[2] for key in records[0]} == set(table.schema.names)
    (first, *_) = loaded(tmp_path / "single").records("train")
    assert [image.size for image in first["train/sensor_image"]] == [(64, 48)] * 3
    (first, *_) = loaded(tmp_path / "small-clips").records("train")
    assert len(first["train/touch_start_time_rel"]) == 3


def test_many_shards_are_one_set_of_files(folder):
    place = DataFolder(str(folder))
    manifest = read_manifest(place)
    assert manifest is not None
    (record,) = manifest.shards_of("test")
    many = [
        msgspec.structs.replace(record, file=ShardName("test", index, 5_000).data_path)
        for index in range(1, 5_000)
    ]
    manifest = replace(manifest, shards=(record, *many, *manifest.shards_of("holdout")))
    facts = folder_facts(place, manifest)
    _, head, body = (folder / "README.md").read_text().split("---\n", 2)
    text = croissant_text(facts, manifest, yaml.safe_load(head), body)
    assert [each["@id"] for each in json.loads(text)["distribution"]] == ["files-test", "files-holdout"]
    (folder / "croissant.json").write_text(text)
    loaded(folder)


@pytest.mark.parametrize(
    ("spoil", "problem"),
    [
        (lambda text: text[:-40], "cannot be read as a JSON object"),
        (lambda text: "[]", "cannot be read as a JSON object"),
        (lambda text: "\x00" * 9, "cannot be read as a JSON object"),
        (lambda text: text.replace("data/test-*", "data/*"), "its 'distribution' is not that"),
        (lambda text: text.replace("cr:Float32", "cr:Float64"), "its 'recordSet' is not that"),
    ],
)
def test_a_lie_is_named_and_the_card_command_mends_it(folder, spoil, problem):
    path = folder / "croissant.json"
    was = path.read_text()
    path.write_text(spoil(was))
    (found,) = check_card(DataFolder(str(folder)))
    assert found.file == "croissant.json"
    assert found.problem.startswith(problem)
    assert "`card`" in found.problem
    assert call("mnist3d", "card", folder) == 0
    assert path.read_text() == was


def test_a_set_made_before_there_was_one_is_whole(folder):
    (folder / "croissant.json").unlink()
    assert check_card(DataFolder(str(folder))) == []


def test_on_the_hub_files_are_those_of_the_repository_and_here_those_of_the_folder(folder):
    place, was = DataFolder(str(folder)), (folder / "croissant.json").read_text()
    page = "https://huggingface.co/datasets/someone/digits"
    manifest = read_manifest(place)
    facts = folder_facts(place, manifest)
    there = croissant_again(was, facts, page)
    (folder / "croissant.json").write_text(there)
    found = loaded(folder, mapping={"repository": str(folder)})
    assert found.metadata.url == page
    assert [record["test/id"] for record in found.records("test")] == [
        row.id for row in mnist3d.load(str(folder), split="test")
    ]
    assert check_card(place) == []
    assert croissant_again(there, facts) == was
