from __future__ import annotations

import json

import pyarrow as pa
import pyarrow.parquet as pq
import pytest

import starstruck_gen
from tests.command_line import run


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    folder = tmp_path_factory.mktemp("cli") / "scenes"
    result = run(
        "starstruck", "generate", "--out", folder, "--scenes", "train=60,test=6", "--workers", 1, "--json"
    )
    assert result.exit_code == 0
    return folder, json.loads(result.stdout)


def test_generate_prints_one_document(made):
    _, document = made
    assert document["complete"]
    assert [(entry["split"], entry["rows"]) for entry in document["splits"]] == [("train", 60), ("test", 6)]


def test_other_options_are_refused_without_a_traceback(made):
    folder, _ = made
    result = run("starstruck", "generate", "--out", folder, "--stars", "1-5")
    assert result.exit_code == 2
    assert "another specification" in result.stderr
    assert "scene.stars is [1, 2, 3] there" in result.stderr
    assert "--overwrite" in result.stderr
    assert "Traceback" not in result.stderr


def test_every_option_reaches_the_specification(tmp_path):
    result = run(
        *("starstruck", "generate", "--out", tmp_path / "set", "--quiet", "--workers", 1, "--split", "test"),
        *("--scenes", 12, "--stars", "2,4", "--distractors", "1-2", "--shapes", "ring,crescent"),
        *("--radius-mm", 6, "--heights-mm", "4,6", "--cell-mm", "150x120", "--collision", "exact"),
        *("--clearance-mm", 0.5, "--seed", 3, "--limit", 8, "--star-points", 6, "--star-inner-mm", 1.5),
    )
    assert result.exit_code == 0
    assert result.stdout == ""
    scenes = starstruck_gen.load(str(tmp_path / "set"), "test")
    assert len(scenes) == 8
    assert scenes.label_names == ("2", "4")
    shapes = {p.shape for record in scenes for p in record.placements}
    assert shapes == {"star(points=6,inner_ratio=0.25)", "ring", "crescent"}
    assert {p.height_m for record in scenes for p in record.placements} == {0.004, 0.006}
    assert {record.distractor_count for record in scenes} == {1, 2}
    manifest = json.loads((tmp_path / "set" / "manifest.json").read_text())
    scene = manifest["spec"]["scene"]
    assert scene["cell_m"] == [0.15, 0.12]
    assert (scene["collision"], scene["clearance_m"], scene["star"]["radius_m"]) == ("exact", 0.0005, 0.006)
    assert scene["star"]["proportions"] == {"points": 6, "inner_ratio": 0.25}
    assert manifest["spec"]["seed"] == 3
    assert run("starstruck", "validate", tmp_path / "set").exit_code == 0


def test_validate_mentions_declared_stars_although_every_scene_fails(made, tmp_path):
    folder, _ = made
    table = pq.ParquetFile(folder / "data" / "test-00000-of-00001.parquet").read(use_threads=False)
    wrong = table.set_column(1, "label", pa.array([9] * len(table)))
    pq.write_table(wrong, tmp_path / "train.parquet")
    result = run("starstruck", "validate", tmp_path / "train.parquet")
    assert result.exit_code == 1
    assert "0 solids, 0 of them stars" in result.stdout
    assert "0 of 6 scenes are valid" in result.stdout
