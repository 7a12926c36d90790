"""Several runs in one folder: none writes or removes files of a data set of another run."""

from __future__ import annotations

import errno
import json
import os
import re
import shutil
from dataclasses import replace
from pathlib import Path

import pytest

from tactile_toolkit.errors import InputError
from tactile_toolkit.run import Part
from tactile_toolkit.run.runners import InlineRunner, ProcessRunner
from tactile_toolkit.store import open_folder, verify
from tactile_toolkit.store.folder import LocalFolder
from tests.command_line import call
from tests.processes import start_held
from tests.tactile_toolkit.toy import SCHEMA, folder_bytes, make, toy_plan


def seeded(seed, **options):
    """A plan whose rows depend on the seed, and whose shards have the same names for all seeds."""
    plan = toy_plan(spec={"seed": seed}, **options)
    ids = [
        tuple(range(100 * seed + 10 * index, 100 * seed + 11 * index + 3)) for index in range(len(plan.tasks))
    ]
    tasks = tuple(replace(task, ids=some) for task, some in zip(plan.tasks, ids, strict=True))
    return replace(plan, tasks=tasks)


@pytest.fixture(scope="module")
def fresh(tmp_path_factory):
    base = tmp_path_factory.mktemp("fresh")
    for seed in (10, 20):
        make(base / str(seed), seeded(seed))
    return {seed: folder_bytes(base / str(seed)) for seed in (10, 20)}


@pytest.mark.one_at_a_desk
@pytest.mark.parametrize("runner", [InlineRunner(), ProcessRunner(2)], ids=["inline", "processes"])
@pytest.mark.parametrize(
    ("shards", "part"), [(1, None), (0, None), (6, None), (0, Part(0, 2)), (1, Part(0, 2))], ids=str
)
def test_a_slower_run_leaves_the_set_that_replaced_its_own(tmp_path, fresh, runner, shards, part):
    """It pauses after some shards while another run starts again there and finishes."""
    made = []

    def hold(progress):
        made.extend([progress] * (progress.record is not None))
        if len(made) == shards and not finished:
            finished.append(make(tmp_path / "set", seeded(20), overwrite=True))

    finished = []
    with pytest.raises(InputError, match="was removed or replaced while this run was at work"):
        make(tmp_path / "set", seeded(10), workers=runner, part=part, on_progress=hold)
    assert finished
    assert folder_bytes(tmp_path / "set") == fresh[20]
    assert verify(open_folder(str(tmp_path / "set")), SCHEMA).ok


def test_where_the_manifest_has_gone_the_reasons_are_named(tmp_path):
    """The folder was removed, or is another folder on the machine that makes the shard."""

    def remove(progress):
        if progress.record is not None and (tmp_path / "set" / "data").exists():
            shutil.rmtree(tmp_path / "set")

    with pytest.raises(InputError, match=r"was removed or replaced while this run was at work, or node "):
        make(tmp_path / "set", seeded(10), on_progress=remove)
    assert folder_bytes(tmp_path / "set") == {}


def test_an_outdated_view_of_a_network_file_system_ends_no_run(tmp_path, fresh, monkeypatch):
    """Such a system may list an outdated state; creating and removing a file updates it."""
    manifest, hidden = tmp_path / "set" / "manifest.json", tmp_path / "hidden"

    def hide(progress):
        if progress.record is not None and progress.done < progress.total / 2:
            manifest.rename(hidden)

    def look_again(folder, path):
        if path == "" and hidden.exists():
            hidden.rename(manifest)

    monkeypatch.setattr(LocalFolder, "refresh", look_again)
    make(tmp_path / "set", seeded(10), on_progress=hide)
    assert folder_bytes(tmp_path / "set") == fresh[10]


@pytest.mark.parametrize("has_links", [True, False])
def test_the_first_of_two_that_create_a_file_wins_on_file_systems_without_links_too(
    tmp_path, monkeypatch, has_links
):
    def refuse(*_, **__):
        raise OSError(errno.EPERM, "Operation not permitted")  # the error of Linux for FAT

    if not has_links:
        monkeypatch.setattr(os, "link", refuse)
    folder = open_folder(str(tmp_path))
    for content in (b"first", b"second"):
        folder.create_bytes("manifest.json", content)
        assert [path.name for path in tmp_path.iterdir()] == ["manifest.json"]
        assert (tmp_path / "manifest.json").read_bytes() == b"first"


@pytest.mark.thorough
def test_a_command_whose_set_was_replaced_ends_with_one_sentence(tmp_path, capfd):
    place, marker = tmp_path / "set", tmp_path / "held"
    words = ("generate", "--scenes", "1200", "--split", "train", "--out", place)
    slow = start_held("starstruck", 1, marker, *words, "--seed", 1, "--workers", 1)
    assert call("starstruck", *words, "--seed", 2, "--overwrite", "--workers", 1) == 0
    before = folder_bytes(place)
    Path(f"{marker}.go").touch()
    _, said = slow.communicate()
    assert slow.returncode == 2
    assert said.decode().strip().splitlines()[-1].startswith("error: the data set in")
    assert "Traceback" not in said.decode()
    assert folder_bytes(place) == before
    assert json.loads(before["manifest.json"])["spec"]["seed"] == 2
    capfd.readouterr()
    assert call("tactile", "verify", place) == 0


@pytest.mark.thorough
def test_a_set_that_another_process_is_about_to_replace_is_left_to_it(tmp_path, capfd):
    """Runs of the present set have nothing to do, and remove no files of the other one."""
    place, marker = tmp_path / "set", tmp_path / "held"
    words = ("generate", "--scenes", "600", "--split", "train", "--out", place)
    assert call("starstruck", *words, "--seed", 1) == 0
    slow = start_held("starstruck", 1, marker, *words, "--seed", 2, "--overwrite", "--workers", 1)
    before = folder_bytes(place)
    assert any(path.startswith(".next/.pending/train-") for path in before)
    for beside in (("--workers", 1), ("--finish",), ("--repair",)):
        assert call("starstruck", *words, "--seed", 1, *beside) == 0
        assert folder_bytes(place) == before
    capfd.readouterr()
    assert call("starstruck", *words, "--seed", 3, "--overwrite", "--workers", 1) == 2
    said = capfd.readouterr().err
    assert re.search(rf"^error: process {slow.pid} on .* holds .*\.next'; next: wait until", said), said
    assert folder_bytes(place) == before
    Path(f"{marker}.go").touch()
    slow.communicate()
    assert slow.returncode == 0
    after = folder_bytes(place)
    assert json.loads(after["manifest.json"])["spec"]["seed"] == 2
    assert not [path for path in after if path.startswith(".")]
    assert call("tactile", "verify", place) == 0
