"""``info`` of folders whose run did not come to its end."""

from __future__ import annotations

import json
from dataclasses import replace

import pytest
from typer.testing import CliRunner

from cli.mnist3d import app
from cli.realtouch import app as touches
from tactile_toolkit import __version__
from tactile_toolkit.errors import StorageError
from tactile_toolkit.run import Part
from tactile_toolkit.store import DataFolder, Manifest, build, write_manifest
from tests.command_line import call
from tests.tactile_toolkit.toy import SPLITS, toy_plan


def info(folder, *options):
    result = CliRunner().invoke(app, ["info", str(folder), *options])
    assert result.exit_code == 0, result.output
    return result.stdout


@pytest.fixture
def stopped(tmp_path):
    """Three of four shards of train are finished, none of test."""
    plan = replace(toy_plan(), kind="mnist3d", report_file=None)
    broken = replace(plan.tasks[3], error=StorageError("stop"))
    with pytest.raises(StorageError, match="stop"):
        build(DataFolder(str(tmp_path)), replace(plan, tasks=(*plan.tasks[:3], broken)))
    return tmp_path


def test_digits_finished_so_far_are_counted(stopped):
    document = json.loads(info(stopped, "--json"))
    assert not document["complete"]
    assert document["shards_planned"] == {"train": 4}
    assert (document["splits"]["train"]["rows"], document["splits"]["train"]["shards"]) == (14, 3)
    assert document["skipped"] == {"nine": 1}
    shown = info(stopped)
    assert "unfinished" in shown
    assert "3 of 4" in shown
    assert "the same `mnist3d generate` continues where it stopped" in shown


def test_a_run_without_a_finished_shard_says_so(tmp_path):
    write_manifest(DataFolder(str(tmp_path)), Manifest("mnist3d", __version__, {"seed": 1}, SPLITS))
    assert json.loads(info(tmp_path, "--json"))["shards_planned"] == {}
    assert "no shard is finished yet" in info(tmp_path)


def test_conversions_of_touches_name_themselves(tmp_path):
    manifest = Manifest("realtouch", __version__, {"operation": "resize"}, SPLITS)
    write_manifest(DataFolder(str(tmp_path)), manifest)
    result = CliRunner().invoke(touches, ["info", str(tmp_path)])
    assert result.exit_code == 0, result.output
    assert "no shard is finished yet; the same `realtouch resize` continues" in result.stdout


def test_verify_says_that_a_run_has_not_finished(tmp_path, capsys):
    folder = tmp_path / "scenes"
    words = ("--scenes", "train=3000,test=10", "--out", folder)
    assert call("starstruck", "generate", *words, "--part", "1/4", "-q") == 0
    capsys.readouterr()
    assert call("starstruck", "verify", folder) == 1
    said = capsys.readouterr().err
    assert said == f"error: '{folder}' is not finished: 1 of 4 shards; the same command continues\n"
    (shard,) = (folder / "data").iterdir()
    shard.write_bytes(shard.read_bytes()[:-1] + b"2")
    assert call("starstruck", "verify", folder) == 3
    said = capsys.readouterr().err
    assert "not finished: 1 of 4 shards" in said
    assert "next: run the same `starstruck generate` with --check" in said
    assert "remove" not in said
    assert call("starstruck", "generate", *words, "--check", "-q") == 0
    assert call("starstruck", "verify", folder) == 0


def test_verify_of_touches_says_it_too(tmp_path):
    plan = replace(toy_plan(("test",)), kind="realtouch", report_file=None, spec={"operation": "resize"})
    build(DataFolder(str(tmp_path)), plan, part=Part(0, 2))
    result = CliRunner().invoke(touches, ["verify", str(tmp_path)])
    assert result.exit_code == 1, result.output
    assert "is not finished: 1 of 2 shards; the same command continues" in result.output
