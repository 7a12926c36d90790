"""Our data sets where the published package wants its own: same values, same behaviour, much faster."""

from __future__ import annotations

import pickle
import threading
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import trimesh

import env_assets
import mnist3d
import realtouch
from tactile_toolkit.errors import InputError
from tests.env_assets.factories import TOUCHES_PER_ROUND, write_meshes
from tests.realtouch import factories

pytestmark = [pytest.mark.env, pytest.mark.filterwarnings("ignore")]


@pytest.fixture
def digits(packages: Any, assets: Path) -> Any:
    return env_assets.as_mesh_dataset(mnist3d.load(str(assets / "mnist3d"), "train"))


@pytest.fixture
def published(packages: Any, assets: Path) -> Any:
    """The same folder by the package's own class."""
    datasets = pytest.importorskip("datasets")
    datasets.disable_progress_bars()
    return packages.SimpleMeshDataset(datasets.load_dataset(str(assets / "mnist3d"), split="train"))


def assert_same_points(ours: Any, theirs: Any) -> None:
    assert len(ours) == len(theirs)
    for point, other in zip(ours, theirs, strict=True):
        assert (point.id, point.label) == (other.id, other.label)
        np.testing.assert_array_equal(np.asarray(point.mesh.vertices), np.asarray(other.mesh.vertices))
        np.testing.assert_array_equal(np.asarray(point.mesh.faces), np.asarray(other.mesh.faces))
        assert point.mesh.volume == other.mesh.volume
        np.testing.assert_array_equal(point.mesh.center_mass, other.mesh.center_mass)


def test_it_is_a_mesh_dataset_of_the_package(packages, digits):
    assert isinstance(digits, packages.MeshDataset)
    assert isinstance(digits[2:5], packages.MeshDataset)


def test_points_are_those_of_the_package(digits, published):
    assert digits.label_names == published.label_names
    assert_same_points(digits, published)


@pytest.mark.parametrize(
    "index",
    [slice(2, 8, 3), [7, 1, 1], np.array([0, 9]), np.arange(10) % 2 == 0, slice(0, 0)],
    ids=["slice", "list", "array", "mask", "nothing"],
)
def test_choosing_rows(digits, published, index):
    assert_same_points(digits[index], published[index])


def test_rows_behind_it_answer_as_those_of_the_hub(packages, digits, published):
    """The statistics of the environments read these rows."""
    ours, theirs = digits.huggingface_dataset, published.huggingface_dataset
    assert len(ours) == len(theirs)
    assert list(ours["id"]) == list(theirs["id"])
    assert list(ours["label"]) == list(theirs["label"])
    assert ours.features["label"].names == theirs.features["label"].names
    assert [row["id"] for row in ours] == list(theirs["id"])
    assert ours[4]["id"] == theirs[4]["id"]
    assert_same_points(packages.SimpleMeshDataset(pickle.loads(pickle.dumps(ours))), published)
    with pytest.raises(InputError, match="no column 'colour'"):
        ours["colour"]


def test_fingerprint_follows_the_content(assets, digits):
    fingerprint = digits.huggingface_dataset._fingerprint
    again = env_assets.as_mesh_dataset(mnist3d.load(str(assets / "mnist3d"), "train"))
    test = env_assets.as_mesh_dataset(mnist3d.load(str(assets / "mnist3d"), "test"))
    assert again.huggingface_dataset._fingerprint == fingerprint
    others = (test, digits[1:], digits[::-1], digits.filter_labels(3))
    assert len({fingerprint, *(other.huggingface_dataset._fingerprint for other in others)}) == 5


def test_meshes_tell_data_sets_apart_where_nothing_else_does(packages, tmp_path):
    """No column of volumes, equal ids, labels and file sizes: one must not pass for the other."""
    found = []
    for name, factor in (("small", 1.0), ("large", 2.0), ("again", 1.0)):
        boxes = [trimesh.creation.box((0.01 * factor, 0.02, 0.01)) for _ in range(10)]
        meshes = mnist3d.load(str(write_meshes(tmp_path / name, boxes)))
        found.append(env_assets.as_mesh_dataset(meshes).huggingface_dataset._fingerprint)
    sizes = {file.stat().st_size for file in tmp_path.rglob("*.parquet")}
    assert len(sizes) == 1
    assert found[0] == found[2] != found[1]


def test_a_plain_list_of_records_will_do(packages, digits, assets):
    records = list(mnist3d.load(str(assets / "mnist3d"), "train"))
    plain = env_assets.as_mesh_dataset(records)
    assert isinstance(plain, packages.MeshDataset)
    assert plain.label_names == digits.label_names
    assert_same_points(plain, digits)
    assert_same_points(plain[::-2], digits[::-2])
    assert_same_points(plain.filter_labels([3, 4]), digits.filter_labels([3, 4]))
    assert_same_points(pickle.loads(pickle.dumps(plain)), digits)
    with pytest.raises(InputError, match="found list"):
        env_assets.as_mesh_dataset([1, 2])


def test_it_pickles(digits):
    copy = pickle.loads(pickle.dumps(digits[3:6]))
    assert_same_points(copy, digits[3:6])
    assert len(pickle.dumps(digits)) < 10_000, "pickled as paths, not as meshes"


def test_the_prefetching_thread_of_the_package(packages, digits):
    """Four data sets share one set of records, as the environments do, each with a thread of its own."""
    order = [3, 1, 4, 1, 5, 9, 2, 6]
    volumes = [digits[index].mesh.volume for index in order]
    found: dict[int, list[float]] = {}

    def collect(number: int) -> None:
        with packages.PrefetchedDataset(digits, capacity=2, load_fn=lambda point: point.mesh) as prefetched:
            prefetched.prefetch(order)
            found[number] = [prefetched[index].mesh.volume for index in order]

    threads = [threading.Thread(target=collect, args=(number,)) for number in range(4)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert list(found.values()) == [volumes] * 4


def test_equal_vertices_are_merged_as_in_the_package(packages, tmp_path):
    """A published mesh may store a corner several times and is closed only once these are merged."""
    datasets = pytest.importorskip("datasets")
    box = trimesh.creation.box((0.02, 0.03, 0.01))
    loose = trimesh.Trimesh(
        box.vertices[box.faces].reshape(-1, 3), np.arange(36).reshape(-1, 3), process=False
    )
    write_meshes(tmp_path / "set", [loose, box])
    ours = env_assets.as_mesh_dataset(mnist3d.load(str(tmp_path / "set")))
    rows = datasets.load_dataset(str(tmp_path / "set"), split="train", cache_dir=str(tmp_path / "cache"))
    assert not ours[0].record.mesh.is_watertight
    assert all(point.mesh.is_watertight for point in ours)
    assert_same_points(ours, packages.SimpleMeshDataset(rows))


def test_touches_are_those_of_the_package(packages, assets):
    datasets = pytest.importorskip("datasets")
    folder = str(assets / "real-single")
    ours = env_assets.as_touch_dataset(realtouch.load(folder))
    theirs = packages.TouchSingleDataset(datasets.load_dataset(folder, split="train"))
    assert isinstance(ours, packages.TouchSingleDataset)
    assert ours.label_names == theirs.label_names
    length = ours.huggingface_dataset.features["pos_in_cell"].length
    assert length == theirs.huggingface_dataset.features["pos_in_cell"].length == TOUCHES_PER_ROUND
    assert ours.huggingface_dataset["label"] == list(theirs.huggingface_dataset["label"])
    assert [point.id for point in pickle.loads(pickle.dumps(ours))[1:]] == [point.id for point in theirs[1:]]
    for point, other in zip(ours, theirs, strict=True):
        assert (point.id, point.label, point.object_id) == (other.id, other.label, other.object_id)
        np.testing.assert_array_equal(point.pos_in_cell, other.pos_in_cell)
        np.testing.assert_allclose(
            point.gel_pose_cell_frame.matrix, other.gel_pose_cell_frame.matrix, atol=1e-12
        )
        assert point.info.keys() == other.info.keys()
        np.testing.assert_allclose(
            point.info["object_pose"].matrix, other.info["object_pose"].matrix, atol=1e-12
        )
        for touch in (0, 11, -1):
            np.testing.assert_array_equal(point.sensor_image[touch], other.sensor_image[touch])


def test_classes_without_rounds_are_empty_as_in_the_package(packages, assets):
    datasets = pytest.importorskip("datasets")
    folder = str(assets / "real-single")
    ours = env_assets.as_touch_dataset(realtouch.load(folder))
    theirs = packages.TouchSingleDataset(datasets.load_dataset(folder, split="train"))
    assert [len(part) for part in ours.by_labels] == [len(part) for part in theirs.by_labels]
    assert len(pickle.loads(pickle.dumps(ours[[]]))) == 0


def test_rounds_of_unlike_length_are_refused(packages, tmp_path):
    made = [factories.make_round(number, 3 + number, (32, 24), frames=(4, 5)) for number in range(2)]
    factories.write_set(
        tmp_path, {"train": factories.single_rows(made)}, "single", factories.Layout(fixed=False)
    )
    rounds = realtouch.load(str(tmp_path))
    with pytest.raises(InputError, match="3 to 4 touches; the environments need the same number in every"):
        env_assets.as_touch_dataset(rounds)
    assert env_assets.as_touch_dataset(rounds[1:]).huggingface_dataset.features["pos_in_cell"].length == 4
