from __future__ import annotations

import pickle

import numpy as np
import pytest

import mnist3d
from mnist3d.sources.synthetic import SyntheticSource
from tactile_toolkit.errors import InputError

ROWS = 10


@pytest.fixture
def folder(digits_set) -> str:
    return str(digits_set)


@pytest.fixture
def digits(folder):
    return mnist3d.load(folder, "test")


def test_records(digits):
    assert len(digits) == ROWS
    assert np.bincount(digits.labels).tolist() == [1] * 10
    source = SyntheticSource()
    for digit in digits[::7]:
        image = source.image(digit.id)
        assert (digit.label, digit.writer, digit.source) == (image.label, image.writer, "synthetic")
        assert digit.vertices_m.dtype == np.float32
        assert digit.faces.dtype == np.int32
        assert digit.mesh is digit.mesh
        assert digit.mesh.is_watertight
        assert digit.mesh.volume == pytest.approx(digit.volume_m3, rel=1e-6)
        assert f"id={digit.id}" in repr(digit)


def test_mesh_equals_the_stored_arrays(digits):
    digit = digits[0]
    assert len(digit.mesh.vertices) == len(digit.vertices_m)
    np.testing.assert_array_equal(digit.mesh.faces, digit.faces)
    assert pickle.loads(pickle.dumps(digit)).mesh.volume == digit.mesh.volume


def test_plain_datasets_reads_the_folder(folder, digits):
    import datasets

    plain = datasets.load_dataset(folder, split="test")
    assert plain.features["label"].names == list(digits.label_names)
    assert plain.column_names[:4] == ["id", "label", "mesh.vertices", "mesh.faces"]
    assert sorted(datasets.get_dataset_split_names(folder)) == ["holdout", "test"]
    assert plain["id"][:] == digits.ids.tolist()
    row = plain.with_format("numpy")[5]
    np.testing.assert_array_equal(np.stack(row["mesh.vertices"]), digits[5].vertices_m)
    np.testing.assert_array_equal(np.stack(row["mesh.faces"]), digits[5].faces)


def test_the_columns_of_the_published_set_are_enough(folder, digits, tmp_path):
    """Ids, labels and meshes: writers are unknown, and volumes follow from the meshes."""
    import pyarrow.parquet as pq

    (shard,) = digits.files
    table = pq.read_table(shard.path, columns=["id", "label", "mesh.vertices", "mesh.faces"])
    pq.write_table(table, tmp_path / "test.parquet")
    published = mnist3d.load(str(tmp_path), "test")
    assert published.writers.tolist() == [digit.writer for digit in published] == [-1] * ROWS
    np.testing.assert_allclose(published.volumes_m3, digits.volumes_m3, rtol=1e-6)


def test_other_columns_are_refused(tmp_path):
    import pyarrow as pa
    import pyarrow.parquet as pq

    pq.write_table(pa.table({"id": [1], "text": ["x"]}), tmp_path / "train.parquet")
    with pytest.raises(InputError, match=r"rows of no kind of this toolkit \(columns id, text\)"):
        mnist3d.load(str(tmp_path))
    pq.write_table(pa.table({"id": [1], "mesh.faces": [[]]}), tmp_path / "train.parquet")
    with pytest.raises(InputError, match="is not a data set of meshes: column 'label' is missing"):
        mnist3d.load(str(tmp_path))


@pytest.mark.oracle
@pytest.mark.filterwarnings("ignore")
def test_published_loader_reads_every_row(folder):
    reason = "needs the extra `oracle` (tactile-mnist, aiohttp)"
    tactile_mnist = pytest.importorskip("tactile_mnist", reason=reason, exc_type=ImportError)
    import datasets

    for split in ("test", "holdout"):
        ours = mnist3d.load(folder, split)
        theirs = tactile_mnist.SimpleMeshDataset(datasets.load_dataset(folder, split=split))
        assert len(theirs) == len(ours) == ROWS
        for mine, point in zip(ours, theirs, strict=True):
            assert (point.id, point.label) == (mine.id, mine.label)
            assert point.mesh.volume == pytest.approx(mine.volume_m3, rel=1e-4)
            np.testing.assert_allclose(point.mesh.bounds, mine.mesh.bounds, atol=1e-7)
            np.testing.assert_allclose(point.mesh.center_mass, mine.mesh.center_mass, atol=1e-6)
            assert len(point.mesh.faces) == len(mine.faces)


def test_relief_shows_the_outline(digits):
    drawn = digits[0].cutout(204)
    inked_mm2 = drawn[..., 1].sum() / 255 * (1e3 * digits[0].extent_m / 200) ** 2
    solid = mnist3d.Mesh(digits[0].vertices_m, digits[0].faces).to_manifold()
    middle_mm2 = solid.project().area()
    assert inked_mm2 == pytest.approx(middle_mm2, rel=0.05)
