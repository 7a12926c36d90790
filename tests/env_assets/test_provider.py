from __future__ import annotations

import pickle
import shutil

import numpy as np
import pytest

import env_assets
import mnist3d
import realtouch
import starstruck_gen
from tactile_toolkit.errors import InputError, IntegrityError
from tactile_toolkit.mesh import SolidDataset
from tests.env_assets.factories import write_meshes
from tests.env_assets.shapes import box
from tests.forked import run_forked


@pytest.mark.parametrize(
    ("name", "split", "kind", "loader"),
    [
        ("mnist3d", "test", mnist3d.DigitDataset, mnist3d.load),
        ("starstruck", "train", starstruck_gen.SceneMeshDataset, starstruck_gen.load),
    ],
)
def test_meshes_are_those_of_the_loader(provider, assets, name, split, kind, loader):
    found, expected = provider.meshes(name, split), loader(str(assets / name), split)
    assert isinstance(found, kind)
    assert (len(found), found.label_names) == (len(expected), expected.label_names)
    for ours, theirs in zip(found, expected, strict=True):
        assert (ours.id, ours.label) == (theirs.id, theirs.label)
        np.testing.assert_array_equal(ours.vertices_m, theirs.vertices_m)
        np.testing.assert_array_equal(ours.faces, theirs.faces)
    assert found[1:3].ids.tolist() == expected[1:3].ids.tolist()
    assert found.filter_labels(0).ids.tolist() == expected.filter_labels(0).ids.tolist()


def test_a_folder_may_be_anywhere_and_names_may_be_given(assets, tmp_path):
    elsewhere = env_assets.AssetProvider(tmp_path, sources={"mnist3d": assets / "mnist3d"})
    by_name, by_path = elsewhere.meshes("mnist3d", "test"), elsewhere.meshes(str(assets / "mnist3d"), "test")
    assert by_name.ids.tolist() == by_path.ids.tolist()
    (file,) = (assets / "mnist3d" / "data").glob("test-*")
    assert elsewhere.meshes(str(file), "test").ids.tolist() == by_name.ids.tolist()


def test_the_kind_follows_from_the_columns_or_else_from_the_classes(tmp_path):
    solids = [box((0, 0, 0), (0.01, 0.01, 0.005)).to_trimesh()] * 3
    provider = env_assets.AssetProvider(tmp_path)
    for names, kind in (
        (tuple("0123456789"), mnist3d.DigitDataset),
        (("1", "2", "3"), starstruck_gen.SceneMeshDataset),
        (("nut", "bolt", "cog"), SolidDataset),
    ):
        write_meshes(tmp_path / names[0], solids, names)
        meshes = provider.meshes(names[0])
        assert isinstance(meshes, kind)
        assert meshes[1].mesh.volume == pytest.approx(5e-7)


def test_touches_come_from_a_folder_of_the_root_first(provider, assets):
    found = provider.touches("real-single")
    expected = realtouch.load(str(assets / "real-single"))
    assert found.ids.tolist() == expected.ids.tolist()
    assert found is provider.touches("real-single")


def test_volumes_are_those_of_the_meshes(provider, assets, tmp_path):
    for name, split in (("mnist3d", "test"), ("starstruck", "train"), ("wrench", "train")):
        volumes = provider.meshes(name, split).volumes_m3
        expected = [record.mesh.volume for record in provider.meshes(name, split)]
        assert volumes.dtype == np.float64
        np.testing.assert_allclose(volumes, expected, rtol=1e-6)


def test_stored_volumes_are_read_without_the_meshes(assets, tmp_path):
    """The bytes of the meshes are damaged: volumes can still be read, meshes cannot."""
    import pyarrow.parquet as pq

    shutil.copytree(assets / "mnist3d", tmp_path / "mnist3d")
    (file,) = (tmp_path / "mnist3d" / "data").glob("test-*")
    column = next(
        pq.ParquetFile(file).metadata.row_group(0).column(place)
        for place in range(8)
        if "vertices" in pq.ParquetFile(file).metadata.row_group(0).column(place).path_in_schema
    )
    start = column.dictionary_page_offset or column.data_page_offset
    content = bytearray(file.read_bytes())
    content[start : start + column.total_compressed_size] = bytes(column.total_compressed_size)
    file.write_bytes(content)
    spoiled = env_assets.AssetProvider(tmp_path)
    whole = env_assets.AssetProvider(assets)
    digits = spoiled.meshes("mnist3d", "test")
    np.testing.assert_array_equal(digits.volumes_m3, whole.meshes("mnist3d", "test").volumes_m3)
    with pytest.raises(IntegrityError, match="damaged"):
        _ = digits[0].vertices_m


def test_a_height_map_is_in_the_frame_of_the_mesh(provider):
    record = provider.meshes("starstruck")[0]
    bounds, heights = record.mesh.bounds, env_assets.top_surface(record, 0.001)
    assert (np.abs(heights.x_m[[0, -1]] - bounds[:, 0]) <= 0.001).all()
    assert (np.abs(heights.y_m[[0, -1]] - bounds[:, 1]) <= 0.001).all()
    for placement in record.placements:
        row = np.abs(heights.y_m - placement.y_m).argmin()
        column = np.abs(heights.x_m - placement.x_m).argmin()
        assert heights.heights_m[row, column] == pytest.approx(placement.height_m)


def test_a_mesh_of_trimesh_is_one_too(provider):
    digit = provider.meshes("mnist3d")[0]
    by_trimesh, own = (env_assets.top_surface(mesh, 0.001) for mesh in (digit.mesh, digit))
    np.testing.assert_array_equal(by_trimesh.heights_m, own.heights_m)
    with pytest.raises(InputError, match="holds no triangles"):
        env_assets.top_surface(3, 0.001)
    with pytest.raises(InputError, match="the pitch of a height map is None m"):
        env_assets.top_surface(digit, None)
    with pytest.raises(InputError, match=r"at most .* are made") as caught:
        env_assets.top_surface(digit, 1e-300)
    assert len(str(caught.value)) < 200


FORKS = """
import sys, env_assets
from tests.env_assets.processes import fingerprint, seen_by_a_child
provider = env_assets.AssetProvider(sys.argv[1])
assert fingerprint(provider) == seen_by_a_child(provider, "fork")
"""


def test_a_forked_process_sees_the_same(assets):
    """After a provider was made and used, in an interpreter without threads of other tests."""
    run_forked(FORKS, assets)


def test_a_copy_is_light_and_opens_again(provider):
    provider.meshes("mnist3d", "test")[0].mesh  # noqa: B018
    packed = pickle.dumps(provider)
    assert len(packed) < 2_000
    copy = pickle.loads(packed)
    assert copy.meshes("mnist3d", "test").ids.tolist() == provider.meshes("mnist3d", "test").ids.tolist()


def test_other_folders_are_named(provider, assets, tmp_path):
    with pytest.raises(InputError, match="does not exist; expected a folder, a Parquet file, a repository"):
        provider.meshes("nothing-of-that-name")
    with pytest.raises(InputError, match=r"no split 'tset' .*it has train, test, printed_train"):
        provider.meshes(str(assets / "mnist3d"), "tset")
    with pytest.raises(InputError, match=r"holds touches; `AssetProvider\.meshes` is for meshes"):
        provider.meshes("real-single")


def test_another_kind_under_the_name_of_a_kind_is_refused(assets, tmp_path):
    provider = env_assets.AssetProvider(tmp_path, sources={"starstruck": assets / "mnist3d"})
    with pytest.raises(InputError, match="'starstruck' was expected to hold scenes, found digits"):
        provider.meshes("starstruck", "test")


def test_sources_do_not_follow_the_current_folder(assets, tmp_path, monkeypatch):
    monkeypatch.chdir(assets)
    provider = env_assets.AssetProvider("nowhere", {"wrench": "wrench"})
    expected = len(provider.meshes(assets / "wrench"))
    monkeypatch.chdir(tmp_path)
    assert len(provider.meshes("wrench")) == expected


@pytest.mark.parametrize("sources", ["digits", ["digits"]])
def test_sources_that_are_not_a_mapping_are_refused(sources):
    with pytest.raises(InputError, match=r"sources .*'digits'.*expected a mapping"):
        env_assets.AssetProvider("assets", sources)


@pytest.mark.parametrize(
    ("name", "near"), [("minst3d", "did you mean 'mnist3d'"), ("digits", "wrench"), (3, "3")]
)
def test_a_source_of_an_unused_name_is_refused(name, near):
    with pytest.raises(InputError, match="expected names of mnist3d, starstruck, wrench, abc") as caught:
        env_assets.AssetProvider("assets", {name: "digits"})
    assert near in str(caught.value)


def test_invalid_names_and_folders_are_refused(provider):
    with pytest.raises(InputError, match="does not exist"):
        provider.meshes("a" * 300)
    with pytest.raises(InputError, match="no home folder is known"):
        env_assets.AssetProvider("~nobody-of-that-name/assets")
