from __future__ import annotations

import hashlib
import json
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pyarrow.parquet as pq
import pytest

from starstruck_gen.sampling import SamplingExhausted, SceneSpec
from starstruck_gen.scene_checks import check_content
from starstruck_gen.scene_dataset import SceneGenerator, SceneSetSpec, generate, make_rows, scene_schema
from starstruck_gen.shapes import Disc, Shape, Star
from tactile_toolkit.errors import InputError, SpecMismatchError
from tactile_toolkit.generation import plan_build
from tactile_toolkit.store import open_folder, read_manifest, verify
from tests.command_line import call


@cache
def small() -> SceneSetSpec:
    """A function, not a constant: its solids are checked by kernels that numba may have to compile."""
    return SceneSetSpec(scenes=(("train", 2_100), ("test", 30)))


def folder_hashes(path: Path) -> dict[str, str]:
    files = (file for file in Path(path).rglob("*") if file.is_file())
    return {str(f.relative_to(path)): hashlib.sha256(f.read_bytes()).hexdigest() for f in files}


@pytest.fixture(scope="module")
def whole(tmp_path_factory) -> Path:
    folder = tmp_path_factory.mktemp("whole")
    generate(small(), str(folder))
    return folder


def test_folder_has_the_documented_files(whole):
    manifest = read_manifest(open_folder(str(whole)))
    assert manifest.complete
    assert manifest.kind == "starstruck"
    rows = {split: entry["rows"] for split, entry in manifest.split_table().items()}
    assert rows == {"train": 2_100, "test": 30}
    assert sorted(folder_hashes(whole)) == [
        "README.md",
        "data/test-00000-of-00001.parquet",
        *(f"data/train-{index:05d}-of-00003.parquet" for index in range(3)),
        "manifest.json",
        "previews/scenes.png",
    ]
    assert verify(open_folder(str(whole)), scene_schema()).ok
    shard = pq.ParquetFile(whole / "data" / "train-00000-of-00003.parquet")
    assert shard.schema_arrow.names[:4] == ["id", "label", "mesh.vertices", "mesh.faces"]
    assert not any(name.startswith("mesh.") for name in shard.schema_arrow.names[4:])


def test_published_size_is_3000_and_300_balanced():
    spec = SceneSetSpec()
    assert (spec.rows("train"), spec.rows("test")) == (3_000, 300)
    tasks = plan_build(SceneGenerator(spec), ("train", "test")).tasks
    for split, size in (("train", 3_000), ("test", 300)):
        assert sum(task.size for task in tasks if task.shard.split == split) == size


def test_limit_gives_the_first_rows(whole, tmp_path):
    generate(replace(small(), limit=10), str(tmp_path / "few"))
    few = pq.read_table(tmp_path / "few" / "data" / "train-00000-of-00001.parquet")
    many = pq.read_table(whole / "data" / "train-00000-of-00003.parquet").slice(0, 10)
    assert few.equals(many)


def test_another_seed_or_specification_is_refused_and_named(whole):
    before = folder_hashes(whole)
    with pytest.raises(SpecMismatchError, match="seed is 0 there, 1 was asked for"):
        generate(replace(small(), seed=1), str(whole))
    with pytest.raises(SpecMismatchError, match=r"scene.stars is \[1, 2, 3\] there"):
        generate(replace(small(), scene=SceneSpec(stars=(1, 2))), str(whole))
    six = Shape("star", 0.010, Star(points=6))
    with pytest.raises(
        SpecMismatchError, match=r"^scene.star.proportions.points is 5 there, 6 was asked for:"
    ):
        generate(replace(small(), scene=SceneSpec(star=six)), str(whole))
    others = (Shape("box"), Shape("disc", 0.010, Disc(segments=64)))
    found = "^scene.distractor_shapes is .*'segments': 32.* there, .*'segments': 64.* was asked for:"
    with pytest.raises(SpecMismatchError, match=found):
        generate(replace(small(), scene=SceneSpec(distractor_shapes=others)), str(whole))
    assert folder_hashes(whole) == before


def test_impossible_specification_leaves_nothing_behind(tmp_path):
    crowded = SceneSetSpec(scene=SceneSpec(stars=(1, 40), restarts=5))
    with pytest.raises(SamplingExhausted, match="a star"):
        generate(crowded, str(tmp_path / "set"))
    assert not (tmp_path / "set").exists()


@pytest.mark.parametrize(
    ("values", "message"),
    [
        ({"scenes": (("train", -1),)}, "expected each of train, test once at most"),
        ({"scenes": (("train", 1), ("train", 2))}, "expected each of train, test once at most"),
        ({"scenes": (("validation", 5),)}, "expected each of train, test once at most"),
        ({"seed": -3}, "seed .* is -3; expected an integer of at least 0"),
        ({"limit": 0}, "limit of .* is 0"),
        ({"scenes": {"train": "many"}}, "scenes .* expected each of train, test"),
        ({"scenes": 5}, "scenes .* is 5"),
        ({"scene": {}}, "scene .* expected a SceneSpec"),
    ],
)
def test_unusable_values_are_refused(values, message):
    with pytest.raises(InputError, match=message):
        SceneSetSpec(**values)


def test_ordinary_values_of_other_types_are_the_same_specification(tmp_path):
    given = SceneSetSpec(
        SceneSpec(stars=range(1, 4), heights_m=[np.float64(0.005)]),
        {"train": np.int64(4)},
        seed=np.int64(3),
        limit=np.int32(2),
    )
    plain = SceneSetSpec(SceneSpec(), (("train", 4),), seed=3, limit=2)
    assert given == plain
    assert json.dumps(given.to_dict()) == json.dumps(plain.to_dict())
    assert SceneSetSpec(scenes=plain.to_dict()["scenes"]).scenes == plain.scenes
    generate(given, tmp_path / "path", ("train",))
    generate(plain, str(tmp_path / "text"), ("train",))
    assert folder_hashes(tmp_path / "path") == folder_hashes(tmp_path / "text")
    job = plan_build(SceneGenerator(given), ("train",))
    assert job.compared_with(open_folder(str(tmp_path / "path"))).remaining == ()


@pytest.mark.parametrize("splits", [("holdout",), ("test",)])
def test_empty_selections_are_refused(tmp_path, splits):
    with pytest.raises(InputError, match=r"unknown split 'holdout'|no scenes to make for test"):
        generate(SceneSetSpec(scenes=(("train", 5),)), str(tmp_path / "set"), splits)


def test_validate_accepts_the_written_scenes(whole):
    checked = check_content(str(whole), limit=30)
    assert (checked.checked, checked.failed, checked.stars) == (60, 0, 120)
    test = check_content(str(whole), "test")
    assert test.failed == 0
    assert test.bodies == sum(len(row.placements) for row in make_rows(SceneSpec(), "test", 0, 0, 30))


def test_a_dry_run_of_a_part_prints_what_that_part_would_make(tmp_path, capsys):
    words = ("generate", "--scenes", "5000", "--split", "train", "--out", tmp_path / "set", "--dry-run")
    for options, rows, shards in (((), 5000, 5), (("--part", "1/3"), 2000, 2), (("--part", "3/3"), 2000, 2)):
        assert call("starstruck", *words, "--json", *options) == 0
        view = json.loads(capsys.readouterr().out)
        assert (view["rows_to_make"], view["splits"][0]["shards"]) == (rows, shards)
    for options, told in (
        (("--part", "4/3"), "there is no part 4 of 3"),
        (("--part", "1/3", "--overwrite"), "--overwrite was given with --part"),
    ):
        assert call("starstruck", *words, *options) == 2
        assert told in capsys.readouterr().err
    assert call("starstruck", *words, "--finish") == 3
    assert "5 of 5 shards" in capsys.readouterr().err
    assert not (tmp_path / "set").exists()
