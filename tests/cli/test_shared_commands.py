"""Shared commands and options: show, list, cache, verify --content, --token, selection of objects."""

from __future__ import annotations

import json
import os
from importlib import import_module
from pathlib import Path

import pyarrow as pa
import pyarrow.parquet as pq
import pytest
import typer

import mnist3d
from tactile_sim.sets.set_options import TouchPlan, TrainConfig
from tactile_toolkit.cache import cache_folder
from tactile_toolkit.errors import InputError
from tests.command_line import call
from tests.processes import printed_by


@pytest.fixture(scope="module")
def digits(tmp_path_factory) -> Path:
    folder = tmp_path_factory.mktemp("sets") / "digits"
    words = ("--split", "test", "--per-class", 2, "--vertices", 2_000, "--workers", 1, "-q")
    assert call("mnist3d", "generate", *words, "--out", folder) == 0
    return folder


def test_a_row_is_shown_column_by_column(digits, capsys):
    assert call("tactile", "show", digits, "--row", 3, "--json") == 0
    document = json.loads(capsys.readouterr().out)
    record = mnist3d.load(str(digits), "test")[3]
    assert (document["split"], document["row"]) == ("test", 3)
    assert (document["values"]["id"], document["values"]["label"]) == (record.id, record.label)
    assert call("tactile", "show", digits, "--row", 3) == 0
    printed = capsys.readouterr().out
    assert f"{len(record.vertices_m):,} values" in printed
    assert "row 3 of the 20 rows in test" in printed
    assert call("tactile", "show", digits, "--row", 20) == 2
    assert "--row is 20; rows are counted from 0, and split " in capsys.readouterr().err


def test_rows_of_foreign_files_with_any_content_are_shown(tmp_path):
    columns = {
        "when": pa.array([1], pa.timestamp("ns")),
        "spans": pa.array([[1, 2]], pa.list_(pa.duration("ns"))),
        "odd": ["\x1b[31mred\x07"],
        "none": [None],
    }
    pq.write_table(pa.table(columns), tmp_path / "train-00000-of-00001.parquet")
    code = f"""
import sys
from cli.tactile import main
sys.argv = ["tactile", "show", {str(tmp_path)!r}]
main()
"""
    # In another process, as users run it: with pandas, which is imported here, Arrow converts more.
    printed = printed_by(code)
    assert "1970-01-01 00:00:00.000000001" in printed
    assert "1, 2" in printed
    assert "\x1b" not in printed
    assert "\x07" not in printed


def test_sets_of_a_folder_are_listed_with_their_problems(digits, tmp_path, capsys):
    (tmp_path / "none").mkdir()
    (tmp_path / "good").symlink_to(digits)
    bad = tmp_path / "bad"
    bad.mkdir()
    (bad / "manifest.json").write_text("{")
    assert call("tactile", "list", tmp_path, "--json") == 0
    first, second = json.loads(capsys.readouterr().out)
    assert (first["name"], first["kind"]) == ("bad", "")
    assert "manifest.json" in first["state"]
    assert (second["name"], second["kind"], second["splits"]) == ("good", "mnist3d", "test")
    assert (second["rows"], second["state"]) == (20, "finished")
    assert call("tactile", "list", tmp_path / "nowhere") == 2


def test_the_cache_is_listed_and_pruned(tmp_path, monkeypatch, capsys):
    monkeypatch.setenv("TACTILE_TOOLKIT_CACHE", str(tmp_path / "cache"))
    assert call("tactile", "cache") == 0
    blocks = [f"blocks/{letter * 32}-00000-00000.arrow" for letter in "ab"]
    files = [cache_folder() / name for name in (*blocks, "locks/held", "blocks/notes.txt")]
    for file in files:
        file.parent.mkdir(parents=True, exist_ok=True)
        file.write_bytes(b"12345")
    os.utime(files[0], (1, 1))
    capsys.readouterr()
    assert call("tactile", "cache", "--json") == 0
    held = json.loads(capsys.readouterr().out)["held"]
    assert held == {"blocks": {"files": 2, "bytes": 10}}
    assert call("tactile", "cache", "--prune", "--unused-days", 30) == 0
    assert [file.exists() for file in files] == [False, True, True, True]
    assert call("tactile", "cache", "--prune") == 0
    assert [file.exists() for file in files] == [False, False, True, True]
    assert call("tactile", "cache", "empty") == 2


def test_verify_checks_the_objects_with_content(digits, capsys):
    assert call("tactile", "verify", digits, "--content", "--json") == 0
    document = json.loads(capsys.readouterr().out)
    assert (document["ok"], document["rows"]) == (True, 20)
    assert [(report["checked"], report["failed"]) for report in document["content"]] == [(20, 0)]


def test_the_option_token_sets_the_token_of_the_hub(digits, monkeypatch):
    monkeypatch.setenv("HF_TOKEN", "another")
    assert call("tactile", "info", digits, "--token", "hf_example", "--no-such") == 2
    assert call("tactile", "info", digits, "--token", "hf_example") == 0
    assert os.environ["HF_TOKEN"] == "hf_example"


def test_ten_digits_are_one_of_each(digits, tmp_path, capsys):
    words = ("--per-class", 1, "--workers", 1, "--json")
    assert call("tactile", "export", digits, *words, "--out", tmp_path / "files") == 0
    files = [file["file"] for file in json.loads(capsys.readouterr().out)["files"]]
    assert sorted(name.split("-")[1] for name in files) == list("0123456789")
    assert call("tactile", "export", digits, "--labels", "3,7", *words, "--out", tmp_path / "some") == 0
    assert len(json.loads(capsys.readouterr().out)["files"]) == 2
    ids = mnist3d.load(str(digits), "test").ids[[0, 5]].tolist()
    page = ("--ids", ",".join(map(str, ids)), "--out", tmp_path / "page", "--json", "--workers", 1)
    assert call("tactile", "gallery", digits, *page) == 0
    assert json.loads(capsys.readouterr().out)["items"] == 2
    sheet = ("--draw", "sheet", "--labels", "3", "--dry-run", "--json")
    assert call("tactile", "preview", digits, *sheet) == 0
    assert "2 digits" in json.loads(capsys.readouterr().out)["pictures"][0]["what"]


def test_options_of_a_training_override_its_file(tmp_path):
    file = tmp_path / "train.toml"
    file.write_text("crop = 1.0\nsteps = 7\n")
    assert TrainConfig.read(file, {"steps": 9}) == TrainConfig(crop=1.0, steps=9)
    wrong = {"croop = 1.0": "'croop'", "crop": "TOML", "steps = 0": "steps of the training is 0"}
    wrong[f"a = {'[' * 20_000}{']' * 20_000}"] = "expected a TOML file"
    for text, words in wrong.items():
        file.write_text(text)
        with pytest.raises(InputError, match=words):
            TrainConfig.read(file, {})


def test_specifications_give_commands_their_options():
    """A field with help is an option, a field without help is not."""
    group = typer.main.get_command(import_module("cli.tactile_sim").app)
    options = {text for option in group.commands["generate"].params for text in option.opts}
    assert {"--rounds", "--turn", "--touches-from"} <= options
    assert "--object-placement" not in options
    assert "object_placement" in TouchPlan.__dataclass_fields__
