from __future__ import annotations

import pickle
import re
from functools import cache

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from hypothesis import given, strategies as st

from starstruck_gen.sampling import SceneSpec, sample_scene, scene_rng
from starstruck_gen.scene import Scene
from starstruck_gen.scene_dataset import (
    SceneDataset,
    SceneMeshDataset,
    SceneRecord,
    SceneSetSpec,
    generate,
    load,
)
from tactile_toolkit.errors import InputError


@cache
def specified() -> SceneSpec:
    """A function, not a constant: its solids are checked by kernels that numba may have to compile."""
    return SceneSpec(stars=(1, 2, 3, 4), collision="exact", heights_m=(0.004, 0.006))


SIZES = {"train": 80, "test": 12}


@pytest.fixture(scope="module")
def folder(tmp_path_factory) -> str:
    path = tmp_path_factory.mktemp("scenes")
    generate(SceneSetSpec(specified(), tuple(SIZES.items()), seed=9), str(path))
    return str(path)


@pytest.fixture(params=["written", "on the fly"])
def scenes(request, folder):
    made = SceneDataset(specified(), "train", 80, seed=9)
    return load(folder, "train") if request.param == "written" else made


def test_data_set_knows_its_classes_without_reading_a_mesh(scenes):
    assert len(scenes) == 80
    assert scenes.label_names == ("1", "2", "3", "4")
    assert scenes.labels.tolist() == [index % 4 for index in range(80)]
    assert scenes.ids.tolist() == list(range(80))
    assert scenes.column("star_count").tolist() == [1 + index % 4 for index in range(80)]
    assert scenes.star_counts.tolist() == [1 + index % 4 for index in range(80)]
    assert scenes[3:9].star_counts.tolist() == [record.star_count for record in scenes[3:9]]
    assert scenes.column("distractor_count").tolist() == [record.distractor_count for record in scenes]
    assert scenes.column("seed").tolist() == [record.seed for record in scenes]
    assert scenes.column("restarts").tolist() == [record.scene.restarts for record in scenes]


def test_record_gives_typed_fields(scenes):
    record = scenes[6]
    assert isinstance(record, SceneRecord)
    assert (record.id, record.label, record.star_count) == (6, 2, 3)
    assert isinstance(record.scene, Scene)
    assert record.scene.placements == record.placements
    assert record.distractor_count == len(record.placements) - 3
    assert [p.is_star for p in record.placements[:3]] == [True] * 3
    assert record.vertices_m.dtype == np.float32
    assert record.faces.dtype == np.int32
    assert not record.vertices_m.flags.writeable
    assert record.mesh.is_watertight
    assert record.mesh is record.mesh
    assert len(record.mesh.vertices) == len(record.vertices_m)
    assert repr(record) == "SceneRecord(id=6, label=2, star_count=3)"
    assert "3 stars, id 6: size" in record._repr_html_()
    with pytest.raises(AttributeError, match="frozen"):
        record.id = 3


def test_row_makes_its_scene_again(scenes):
    record = scenes[17]
    again = sample_scene(specified(), scene_rng(record.seed), record.star_count)
    assert again == record.scene
    assert again.mesh().vertices_m.tobytes() == record.vertices_m.tobytes()


def test_written_rows_and_rows_on_the_fly_are_identical(folder):
    for split, size in SIZES.items():
        written, made = load(folder, split), SceneDataset(specified(), split, size, seed=9)
        assert written.label_names == made.label_names
        for a, b in zip(written, made, strict=True):
            assert a.vertices_m.tobytes() == b.vertices_m.tobytes()
            assert np.array_equal(a.faces, b.faces)
            assert a.scene == b.scene
            assert (a.id, a.label, a.seed, a.star_count) == (b.id, b.label, b.seed, b.star_count)
            assert a.distractor_count == b.distractor_count


@given(st.integers(0, 10**6 - 1), st.integers(0, 2**32), st.sampled_from(["train", "test"]))
def test_scene_does_not_depend_on_the_size_of_its_data_set(index, seed, split):
    small = SceneDataset(split=split, size=index + 1, seed=seed)[index]
    large = SceneDataset(split=split, size=10**6, seed=seed)[index]
    assert small.scene == large.scene
    assert small.id == large.id


def test_records_and_data_sets_cross_process_borders(scenes):
    record = scenes[5]
    copy = pickle.loads(pickle.dumps(record))
    assert copy.scene == record.scene
    assert copy.vertices_m.tobytes() == record.vertices_m.tobytes()
    again = pickle.loads(pickle.dumps(scenes[4:]))
    assert again[1].scene == record.scene


def test_numbers_of_numpy_give_the_same_scenes():
    given, plain = SceneDataset(size=np.int64(3), seed=np.int64(5)), SceneDataset(size=3, seed=5)
    assert [record.scene for record in given] == [record.scene for record in plain]
    assert type(sample_scene(SceneSpec(), scene_rng(1), np.int64(2)).star_count) is int


@pytest.mark.parametrize(
    ("values", "message"),
    [
        ({"split": "dev"}, "unknown split 'dev'"),
        ({"size": -1}, "size is -1"),
        ({"seed": -1}, "seed is -1"),
        ({"seed": 10**45}, "seed is 10{45}; expected an integer of at least 0, below 2"),
        ({"size": 2.5}, "size is 2.5"),
        ({"seed": "a"}, "seed is 'a'"),
    ],
)
def test_unusable_data_set_on_the_fly_is_refused(values, message):
    with pytest.raises(InputError, match=message):
        SceneDataset(**values)


def test_load_dataset_reads_classes_and_columns(folder):
    datasets = pytest.importorskip("datasets")
    rows = datasets.load_dataset(folder, split="test")
    assert rows.features["label"].names == ["1", "2", "3", "4"]
    assert rows.column_names[:4] == ["id", "label", "mesh.vertices", "mesh.faces"]
    record = load(folder, "test")[3]
    assert np.array_equal(np.asarray(rows[3]["mesh.vertices"], np.float32), record.vertices_m)
    assert rows[3]["placements"] == [placement._asdict() for placement in record.placements]
    assert set(datasets.load_dataset(folder)) == {"train", "test"}


def test_published_columns_alone_are_enough(folder, tmp_path):
    table = pq.read_table(re.sub("$", "/data/test-00000-of-00001.parquet", folder))
    bare = table.select(["id", "label", "mesh.vertices", "mesh.faces"]).replace_schema_metadata()
    pq.write_table(bare, tmp_path / "train-00000-of-00001.parquet")
    scenes = load(str(tmp_path))
    assert isinstance(scenes, SceneMeshDataset)
    assert scenes.label_names == ("1", "2", "3")
    assert scenes[2].star_count == 3
    assert scenes.star_counts.tolist() == [record.star_count for record in scenes]
    (tmp_path / "rich").mkdir()
    rich = table.set_column(4, "star_count", pa.array([7] * len(table))).replace_schema_metadata()
    pq.write_table(rich, tmp_path / "rich" / "train-00000-of-00001.parquet")
    both = scenes + load(str(tmp_path / "rich"))
    assert both.star_counts.tolist() == [record.star_count for record in both]
    assert 7 in both.star_counts
    assert scenes[2].mesh.is_watertight
    assert scenes[2]._repr_html_().count("<img") == 1
    assert scenes._repr_html_().count("<img") == min(len(scenes), 8)
    for name in ("placements", "scene", "seed", "distractor_count"):
        with pytest.raises(InputError, match="this data set stores no"):
            getattr(scenes[2], name)
