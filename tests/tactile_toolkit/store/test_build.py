from __future__ import annotations

import errno
import gc
import importlib.metadata
import os
import shutil
import subprocess
import sys
import tempfile
import textwrap
import time
from dataclasses import replace
from pathlib import Path

import pyarrow.parquet as pq
import pytest

from tactile_toolkit.errors import InputError, IntegrityError, SpecMismatchError, StorageError, ToolkitError
from tactile_toolkit.run import Part
from tactile_toolkit.run.runners import ProcessRunner
from tactile_toolkit.store import build, open_folder, read_manifest, verify
from tests.forked import run_forked
from tests.processes import children, wait_until_gone
from tests.tactile_toolkit.toy import SCHEMA, folder_bytes, make, toy_plan


def test_folder_holds_shards_report_and_manifest_and_nothing_else(tmp_path):
    manifest = make(tmp_path / "set")
    assert manifest.complete
    assert manifest.split_table()["train"] == {
        "rows": 18,
        "shards": 4,
        "bytes": sum(r.bytes for r in manifest.shards_of("train")),
        "skipped": 2,
    }
    assert manifest.skipped_reasons() == {"nine": 3}
    files = sorted(folder_bytes(tmp_path / "set"))
    shards = [f"data/test-{i:05d}-of-00002.parquet" for i in range(2)]
    shards += [f"data/train-{i:05d}-of-00004.parquet" for i in range(4)]
    assert files == [*shards, "manifest.json", "reports/toy.parquet"]
    assert read_manifest(open_folder(str(tmp_path / "set"))) == manifest
    report = pq.read_table(tmp_path / "set" / "reports" / "toy.parquet")
    ids = [i for i in range(20) if i % 10 != 9] + list(range(100, 109))
    assert report["id"].to_pylist() == ids


def test_bytes_do_not_depend_on_workers(tmp_path):
    make(tmp_path / "one")
    make(tmp_path / "many", workers=ProcessRunner(2))
    assert folder_bytes(tmp_path / "one") == folder_bytes(tmp_path / "many")


def test_second_run_changes_nothing(tmp_path):
    make(tmp_path / "set")
    before = {f: f.stat().st_mtime_ns for f in (tmp_path / "set").rglob("*") if f.is_file()}
    calls = []
    make(tmp_path / "set", toy_plan(error=RuntimeError("nothing is to be made")), on_progress=calls.append)
    assert {f: f.stat().st_mtime_ns for f in (tmp_path / "set").rglob("*") if f.is_file()} == before
    assert [(call.done, call.total) for call in calls] == [(0, 0)]


@pytest.mark.one_at_a_desk
@pytest.mark.parametrize("damage", ["cut", "flip", "remove"])
@pytest.mark.parametrize("victim", ["data/train-00001-of-00004.parquet", "reports/toy.parquet"])
def test_damaged_file_is_found_and_made_again(tmp_path, damage, victim):
    make(tmp_path / "whole")
    make(tmp_path / "set")
    file = tmp_path / "set" / victim
    content = bytearray(file.read_bytes())
    if damage == "remove":
        file.unlink()
    else:
        content[len(content) // 2] ^= 0xFF
        file.write_bytes(content[:-7] if damage == "cut" else content)
    folder = open_folder(str(tmp_path / "set"))
    assert [finding.file for finding in verify(folder, SCHEMA).findings] == [victim]
    make(tmp_path / "set", check=damage == "flip")
    assert verify(folder, SCHEMA).ok
    assert folder_bytes(tmp_path / "whole") == folder_bytes(tmp_path / "set")


def test_another_spec_is_refused_and_named(tmp_path):
    make(tmp_path / "set")
    before = folder_bytes(tmp_path / "set")
    with pytest.raises(SpecMismatchError, match=r"seed is 1 there, 2 was asked for.*--overwrite"):
        make(tmp_path / "set", toy_plan(spec={"seed": 2, "size": [1, 2]}))
    assert folder_bytes(tmp_path / "set") == before
    manifest = make(tmp_path / "set", toy_plan(spec={"seed": 2, "size": [1, 2]}), overwrite=True)
    assert manifest.spec["seed"] == 2


@pytest.mark.parametrize("overwrite", [False, True])
def test_folder_with_strange_files_is_never_touched(tmp_path, overwrite):
    (tmp_path / "thesis.tex").write_text("years of work")
    with pytest.raises(InputError, match=r"not empty.*thesis\.tex.*--out"):
        make(tmp_path, overwrite=overwrite)
    assert folder_bytes(tmp_path) == {"thesis.tex": b"years of work"}


def test_damaged_manifest_is_named(tmp_path):
    make(tmp_path / "set")
    (tmp_path / "set" / "manifest.json").write_text('{"schema_version": 1')
    with pytest.raises(IntegrityError, match=r"manifest\.json' is damaged: "):
        make(tmp_path / "set")
    assert gc.isenabled(), "manifests are read without collecting garbage"


class Forgetful:
    """A runner that makes only some tasks."""

    def __init__(self, *left_out):
        self.left_out = left_out

    def run(self, function, tasks):
        yield from (function(task) for number, task in enumerate(tasks) if number not in self.left_out)


def test_a_set_is_complete_only_with_the_shards_of_all_tasks(tmp_path):
    make(tmp_path / "whole")
    with pytest.raises(
        IntegrityError, match=r"1 of 6 shards .* those of part 2 of 6; next: .*run the same command"
    ):
        make(tmp_path / "set", workers=Forgetful(2))
    assert not read_manifest(open_folder(str(tmp_path / "set"))).complete
    (tmp_path / "set" / "data" / "train-00000-of-00004.parquet").unlink()
    with pytest.raises(IntegrityError, match=r"2 of 6 shards .* those of parts 0,2 of 6"):
        make(tmp_path / "set", workers=Forgetful(0, 1))
    make(tmp_path / "set")
    assert folder_bytes(tmp_path / "whole") == folder_bytes(tmp_path / "set")
    with pytest.raises(IntegrityError, match=r"6 of 6 shards"):
        make(tmp_path / "none", workers=Forgetful(*range(6)))
    assert not (tmp_path / "none").exists()
    with pytest.raises(IntegrityError, match=r"1 of 6 shards .* those of part 2 of 6"):
        make(tmp_path / "part", part=Part(0, 2), workers=Forgetful(1))


@pytest.mark.thorough
def test_task_that_always_kills_its_worker_ends_the_run(tmp_path):
    plan = toy_plan(("test",))
    tasks = (replace(plan.tasks[0], die_always=True), plan.tasks[1])
    with pytest.raises(ToolkitError, match=r"worker process died 3 times.*--workers"):
        make(tmp_path / "set", replace(plan, tasks=tasks), workers=ProcessRunner(1))


def test_full_disk_is_named_and_leaves_no_partial_file(tmp_path):
    """A limit on the file size simulates a full disk: the kernel refuses the write half way."""
    said = run_forked(
        """
        import resource, signal, sys
        from tactile_toolkit.errors import StorageError
        from tests.tactile_toolkit.toy import make
        signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
        resource.setrlimit(resource.RLIMIT_FSIZE, (1500, resource.RLIM_INFINITY))
        try:
            make(sys.argv[1])
        except StorageError as error:
            print(error)
        """,
        tmp_path / "set",
    )
    assert "cannot write" in said
    assert "File too large" in said
    assert not (tmp_path / "set").exists()
    make(tmp_path / "set")
    assert verify(open_folder(str(tmp_path / "set")), SCHEMA).ok


def test_no_space_hint(monkeypatch, tmp_path):
    def refuse(handle):
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr(os, "fsync", refuse)
    with pytest.raises(StorageError, match=r"No space left on device.*no partial file remains"):
        open_folder(str(tmp_path)).write_bytes("data/file", b"1")
    assert folder_bytes(tmp_path) == {}


@pytest.mark.parametrize("mode", [0o555, 0o000])
def test_read_only_place(mode):
    # Not below pytest's own temporary folder, which only its owner may enter.
    base = Path(tempfile.mkdtemp())
    base.chmod(0o755)
    place = base / "set"
    place.mkdir(mode=mode)
    was_root = os.geteuid() == 0
    if was_root:
        os.seteuid(65534)  # root may write anywhere; the user nobody may not
    try:
        for folder in (place / "inner", place):
            with pytest.raises(InputError, match=r"set.*(?i:permission denied).*; next: "):
                make(folder)
    finally:
        if was_root:
            os.seteuid(0)
        shutil.rmtree(base)


def test_remote_folder_through_fsspec(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    folder = open_folder("memory://bucket/set")
    manifest = build(folder, toy_plan())
    assert manifest.complete
    assert verify(folder, SCHEMA).ok
    assert build(folder, toy_plan(error=RuntimeError("all is there"))) == manifest
    assert not hasattr(folder, "move")
    assert folder.exists("manifest.json")
    assert list(tmp_path.iterdir()) == [], "an address is not a local path"


def test_another_source_gives_a_short_message(tmp_path):
    def files(count, digest):
        return [{"file": f"train-{index}.parquet", "rows": 9, "sha256": digest} for index in range(count)]

    make(tmp_path / "set", toy_plan(spec={"source": {"train": files(48, "a" * 64)}}))
    wanted = r"source\.train is .*\(fingerprint \w+\) there, .* was asked for:"
    with pytest.raises(SpecMismatchError, match=wanted):
        make(tmp_path / "set", toy_plan(spec={"source": {"train": files(2, "a" * 64)}}))
    with pytest.raises(
        SpecMismatchError, match=r"\(fingerprint .* there, .*\(fingerprint .* asked for"
    ) as told:
        make(tmp_path / "set", toy_plan(spec={"source": {"train": files(48, "b" * 64)}}))
    assert len(str(told.value)) < 500
    make(tmp_path / "other", toy_plan(spec={"source": "a" * 300}))
    begins = r"'{0}{{50,200}}\.\.\. \(fingerprint"
    with pytest.raises(SpecMismatchError, match=f"{begins.format('a')} .* there, {begins.format('b')}"):
        make(tmp_path / "other", toy_plan(spec={"source": "b" * 300}))


@pytest.mark.thorough
def test_workers_leave_with_a_killed_parent(tmp_path):
    code = """
        import sys
        from tactile_toolkit.run.runners import ProcessRunner
        from tests.tactile_toolkit.toy import make, toy_plan
        make(sys.argv[1], toy_plan(pause_s=2.0), workers=ProcessRunner(2))
        """
    words = [sys.executable, "-c", textwrap.dedent(code), str(tmp_path / "set")]
    process = subprocess.Popen(words, cwd=Path(__file__).resolve().parents[3])
    deadline_s = time.monotonic() + 120
    while len(children(process.pid)) < 3 and time.monotonic() < deadline_s:
        time.sleep(0.02)  # two workers and multiprocessing's resource tracker
    workers = children(process.pid)
    assert len(workers) >= 2
    process.kill()
    process.wait()
    wait_until_gone(workers)


def test_other_versions_of_libraries_are_not_mixed(tmp_path, monkeypatch):
    plan = replace(toy_plan(), libraries=("numpy", "pyarrow"))
    made = make(tmp_path / "set", plan)
    assert made.libraries == {name: importlib.metadata.version(name) for name in plan.libraries}
    monkeypatch.setattr("tactile_toolkit.store.job.version", lambda name: "9")
    before = folder_bytes(tmp_path / "set")
    make(tmp_path / "set", plan)  # nothing is left to make, so nothing is mixed
    assert folder_bytes(tmp_path / "set") == before
    (tmp_path / "set" / "data" / "test-00000-of-00002.parquet").unlink()
    with pytest.raises(SpecMismatchError, match=r"libraries\.numpy is '[\d.]+' there, '9' .*--overwrite"):
        make(tmp_path / "set", plan)
    shutil.rmtree(tmp_path / "set" / "data")
    assert make(tmp_path / "set", plan).libraries == {"numpy": "9", "pyarrow": "9"}


@pytest.mark.parametrize("name", ["notes.txt", "x.parquet", "train-00000-of-00009.parquet"])
def test_a_stray_file_among_the_shards_is_named_by_all_commands(tmp_path, name):
    """`verify` must not recommend a run that ignores the file."""
    folder = open_folder(str(tmp_path / "set"))
    build(folder, toy_plan())
    (tmp_path / "set" / "data" / name).write_bytes(b"x")
    before = folder_bytes(tmp_path)
    (finding,) = verify(folder, SCHEMA).findings
    assert (finding.file, finding.problem) == (
        f"data/{name}",
        "is not listed in manifest.json; next: move it to another folder",
    )
    with pytest.raises(
        InputError, match=rf"data/{name}' is not a file of this data set.*next: move it to another folder"
    ):
        build(folder, toy_plan())
    assert folder_bytes(tmp_path) == before


def test_a_shard_of_a_split_that_another_run_makes_is_no_stray_file(tmp_path):
    folder = open_folder(str(tmp_path / "set"))
    build(folder, toy_plan(("train",)))
    folder.write_bytes("data/test-00000-of-00002.parquet", b"rows whose record is not written yet")
    build(folder, toy_plan(("train",)))
    build(folder, toy_plan(("test",)))
    assert verify(folder, SCHEMA).ok
