"""Downloads from a real server: requested files, kept files, and no damaged file in the result."""

from __future__ import annotations

import os
import signal
import threading
import time
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor, wait
from pathlib import Path

import pytest
from huggingface_hub import __version__ as client_version, constants, file_download

from tactile_toolkit.errors import InputError, IntegrityError
from tactile_toolkit.exchange import DownloadPlan
from tactile_toolkit.places import open_place
from tactile_toolkit.store import build, open_folder, verify
from tests.hub_server import HubServer
from tests.processes import PATIENCE_S
from tests.tactile_toolkit.exchange.upload_client import logged_in
from tests.tactile_toolkit.hub.client import settings, start_here
from tests.tactile_toolkit.hub.sets import (
    BIG,
    CONTENT,
    FULL,
    NAME,
    SHARD,
    big_parquet,
    fetch,
    script,
    two_sets,
)
from tests.tactile_toolkit.toy import SCHEMA, folder_bytes, toy_plan

RECORD = ".download.json"


@pytest.fixture
def server(tmp_path) -> Iterator[HubServer]:
    with two_sets(tmp_path / "root") as running:
        yield running


def test_a_split_in_a_folder_is_a_data_set_of_its_own(server, tmp_path):
    out = tmp_path / "part"
    place, missing, leftover, done = fetch(server, tmp_path, script(NAME, "test", out=out))
    shards = [f"data/test-0000{index}-of-00002.parquet" for index in range(2)]
    assert (place, leftover, done) == (str(out), [], False)
    assert sorted(missing) == [*shards, "reports/toy.parquet"]
    assert sorted(path for path in server.fetched if path != "manifest.json") == sorted(missing)
    result = verify(open_folder(str(out)), SCHEMA)
    assert result.ok, result.findings
    assert result.rows == 9
    assert len(open_place(str(out)).shards("test")) == 2
    assert folder_bytes(out)[shards[0]] == folder_bytes(server.root / NAME)[shards[0]]


def test_a_repetition_fetches_nothing_and_another_split_completes_the_set(server, tmp_path):
    out = tmp_path / "part"
    fetch(server, tmp_path, script(NAME, "test", out=out))
    before, state = len(server.fetched), folder_bytes(out)
    assert fetch(server, tmp_path, script(NAME, "test", out=out))[3] is True
    assert len(server.fetched) == before
    assert folder_bytes(out) == state
    assert len(fetch(server, tmp_path, script(NAME, "train", out=out))[1]) == 4
    whole = folder_bytes(out)
    del whole[RECORD]
    assert whole == folder_bytes(server.root / NAME)


@pytest.fixture
def client_here(server, tmp_path, monkeypatch) -> Iterator[None]:
    monkeypatch.setattr(constants, "HF_HUB_CACHE", str(tmp_path / "hub"))
    with logged_in(server, server.account("else"), monkeypatch):
        yield


@pytest.mark.parametrize("to_folder", [True, False])
def test_progress_ends_with_all_bytes_that_were_missing(server, tmp_path, client_here, to_folder):
    plan = DownloadPlan.of(NAME, ["test"], out=str(tmp_path / "out") if to_folder else None)
    reported: list[tuple[int, int]] = []
    plan.run(lambda *counts: reported.append(counts))
    assert reported == sorted(reported)
    assert reported[-1] == (plan.missing_bytes, plan.missing_bytes)
    assert plan.missing_bytes == sum(file.size_bytes for file in plan.missing) > 0


@pytest.mark.parametrize("at_work", ["train", "test"])
def test_downloads_of_two_splits_at_once_make_one_set_of_both(server, tmp_path, client_here, at_work):
    """One download pauses in the middle of a file when another one, planned as early, begins."""
    out = str(tmp_path / "both")
    said: list[str] = []
    plans = {
        split: DownloadPlan.of(NAME, [split], out=out, on_wait=said.append) for split in ("train", "test")
    }
    server.faults.stall(f"*/{at_work}-00000-of-*", after=10)
    first, second = plans.pop(at_work), plans.popitem()[1]
    with ThreadPoolExecutor(2) as threads:
        done = [threads.submit(first.run)]
        assert server.faults.stalled.wait(PATIENCE_S)
        done.append(threads.submit(second.run))
        while not said and not done[1].done():
            wait([done[1]], 0.05)
        server.faults.released.set()
        assert [each.result(PATIENCE_S) for each in done] == [out, out]
    assert "this download begins when it has ended" in said[0]
    result = verify(open_folder(out), SCHEMA)
    assert result.ok, result.findings
    assert {
        path: content for path, content in folder_bytes(Path(out)).items() if path != RECORD
    } == folder_bytes(server.root / NAME)


@pytest.mark.parametrize(
    "link", ["data", "reports", ".pending", "manifest.json", "data/test-00000-of-00002.parquet"]
)
def test_nothing_is_written_through_links_in_the_folder(server, tmp_path, client_here, link):
    out, elsewhere = tmp_path / "out", tmp_path / "elsewhere"
    DownloadPlan.of(NAME, ["train"], out=str(out)).run()
    elsewhere.mkdir()
    target = elsewhere / "target"
    if (out / link).exists():
        (out / link).rename(target)
    else:
        target.write_text("mine")
    (out / link).symlink_to(target)
    before = folder_bytes(elsewhere)
    with pytest.raises(InputError, match=r"is a symbolic link|a file of your own"):
        DownloadPlan.of(NAME, ["test"], out=str(out)).run()
    assert folder_bytes(elsewhere) == before
    assert (out / link).is_symlink()


def test_only_downloaded_files_that_the_hub_no_longer_has_are_removed(server, tmp_path):
    out = tmp_path / "out"
    fetch(server, tmp_path, script(out=out))
    (out / "notes.txt").write_text("mine")
    mine = [out / ".cache" / "huggingface" / name for name in ("notes.txt", "download/notes.txt")]
    for path in mine:
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text("mine")
    (server.root / NAME / "reports" / "toy.parquet").unlink()
    build(open_folder(str(server.root / NAME)), toy_plan(spec={"seed": 2}), overwrite=True)
    (server.root / NAME / "reports" / "toy.parquet").rename(server.root / NAME / "reports" / "new.parquet")
    _, missing, leftover, _ = fetch(server, tmp_path, script(out=out))
    assert leftover == ["reports/toy.parquet"]
    assert missing == ["reports/new.parquet"], "shards whose bytes are the same were fetched again"
    assert sorted(path.name for path in (out / "reports").iterdir()) == ["new.parquet"]
    mine.append(out / "notes.txt")
    assert {path.read_text() for path in mine} == {"mine"}
    hidden = [path for path in (out / ".cache").rglob("*") if path.is_file()]
    assert sorted(hidden) == sorted(mine[:2]), "of the client's files none stays"
    assert (out / "manifest.json").read_bytes() == (server.root / NAME / "manifest.json").read_bytes()


def test_a_revision(server, tmp_path):
    first = server.repository(BIG).head.sha
    server.repository(BIG).tags["v1"] = first
    other = big_parquet(1)
    server.repository(BIG).commit({SHARD: server.repository(BIG).blob(SHARD, other)}, "other")
    out = tmp_path / "out"
    for revision, content in (("v1", CONTENT), ("main", other), (first, CONTENT)):
        fetch(server, tmp_path, script(BIG, out=out, revision=revision))
        assert (out / SHARD).read_bytes() == content
    code, kind, words = fetch(server, tmp_path, script(BIG, out=out, revision="v2"))
    assert (code, kind) == (4, "HubError")
    assert "(404): " in words
    assert (out / SHARD).read_bytes() == CONTENT


def test_another_data_set_is_not_overwritten(server, tmp_path):
    own = tmp_path / "own"
    build(open_folder(str(own)), toy_plan(spec={"seed": 3}))
    before = folder_bytes(own)
    code, kind, words = fetch(server, tmp_path, script(out=own))
    assert (code, kind) == (2, "SpecMismatchError")
    assert "holds a data set of another origin" in words
    assert "--out" in words
    out = tmp_path / "out"
    fetch(server, tmp_path, script(BIG, out=out))
    assert "a download of 'someone/big'" in fetch(server, tmp_path, script(out=out))[2]
    assert folder_bytes(own) == before


@pytest.mark.parametrize("to_folder", [False, True])
def test_a_bit_that_the_disk_has_flipped_is_found_though_size_and_time_are_kept(server, tmp_path, to_folder):
    out = tmp_path / "out" if to_folder else None
    file = Path(fetch(server, tmp_path, script(BIG, out=out))[0], SHARD).resolve()
    before = file.stat()
    with file.open("r+b") as stream:
        stream.seek(1000)
        stream.write(bytes([CONTENT[1000] ^ 1]))
    os.utime(file, ns=(before.st_atime_ns, before.st_mtime_ns))
    assert fetch(server, tmp_path, script(BIG, out=out))[1:] == [[SHARD], [], False]
    assert Path(fetch(server, tmp_path, script(BIG, out=out))[0], SHARD).read_bytes() == CONTENT


@pytest.mark.parametrize("to_folder", [False, True])
def test_a_killed_download_does_not_look_complete(server, tmp_path, to_folder):
    out = tmp_path / "out" if to_folder else None
    server.faults.stall(f"*/{SHARD}", after=1_500_000)
    process = start_here(script(BIG, out=out), settings(server, tmp_path), tmp_path)
    assert server.faults.stalled.wait(PATIENCE_S)
    assert process.end(signal.SIGKILL) == -signal.SIGKILL
    server.faults.released.set()
    assert not list(tmp_path.rglob(Path(SHARD).name)), "a half file stands under the name of a whole one"
    place = Path(fetch(server, tmp_path, script(BIG, out=out))[0])
    assert (place / SHARD).read_bytes() == CONTENT
    first, second = (request.range for request in server.content_requests(SHARD))
    assert first is None
    assert second is None or second.endswith("-"), "early releases of the client continue within the file"
    if out is not None:
        assert not list(out.rglob("*.incomplete"))


def test_a_killed_download_goes_on_with_the_files_that_are_missing(server, tmp_path):
    out, last = tmp_path / "out", "data/train-00003-of-00004.parquet"
    server.faults.stall(f"*/{last}", after=10)
    process = start_here(script(NAME, "train", out=out), settings(server, tmp_path), tmp_path)
    assert server.faults.stalled.wait(PATIENCE_S)
    while len(list((out / "data").glob("train*"))) < 3:
        assert process.is_running, process.err
        time.sleep(0.01)
    assert process.end(signal.SIGKILL) == -signal.SIGKILL
    server.faults.released.set()
    before = len(server.fetched)
    assert [
        path for path in fetch(server, tmp_path, script(NAME, "train", out=out))[1] if "data" in path
    ] == [last]
    assert [path for path in server.fetched[before:] if path.startswith("data")] == [last]
    assert verify(open_folder(str(out)), SCHEMA).ok


def test_an_interrupted_folder_is_not_taken_for_a_data_set(server, tmp_path):
    out = tmp_path / "out"
    server.faults.fail("*/data/train-00002*", 503, times=99)
    code, kind, words = fetch(server, tmp_path, script(NAME, "train", out=out))
    assert (code, kind) == (4, "HubError")
    assert "the Hub answered 503" in words
    assert not (out / "data" / "train-00002-of-00004.parquet").exists()
    assert not verify(open_folder(str(out)), SCHEMA).ok
    with pytest.raises(IntegrityError, match="not finished"):
        open_place(str(out)).shards("train")
    server.faults.clear()
    assert "data/train-00002-of-00004.parquet" in fetch(server, tmp_path, script(NAME, "train", out=out))[1]
    assert verify(open_folder(str(out)), SCHEMA).ok


@pytest.mark.skipif(
    client_version.startswith("0."), reason="locks of clients before 1.0 are held in other places"
)
def test_threads_of_a_failed_download_do_not_affect_a_later_one(server, tmp_path, monkeypatch):
    """The first failure ends a download; the thread of another file, about to write, continues later."""
    out, going = tmp_path / "out", threading.Event()
    threads, late = {*threading.enumerate()}, []

    def lock_late(path, *args, _lock=file_download.WeakFileLock, **options):
        if "toy.parquet" in str(path) and not late:
            late.append(threading.current_thread())
            going.wait(PATIENCE_S)
        return _lock(path, *args, **options)

    monkeypatch.setattr(file_download, "WeakFileLock", lock_late)
    server.faults.fail("*/data/train-00002*", 503, times=99)
    assert fetch(server, tmp_path, script(NAME, "train", out=out))[0] == 4
    assert late, "the thread of the report stands still"
    server.faults.clear()
    fetch(server, tmp_path, script(NAME, "train", out=out))
    going.set()
    for thread in {*threading.enumerate()} - threads:
        thread.join(PATIENCE_S)
    assert verify(open_folder(str(out)), SCHEMA).ok


@pytest.mark.parametrize("kept_in_git", [False, True])
def test_a_flipped_byte_is_repaired(server, tmp_path, kept_in_git):
    files = {"README.md": b"#", SHARD: CONTENT}
    if kept_in_git:
        repository = server.create("someone/big")
        repository.lfs_suffixes = frozenset()
        repository.commit({path: repository.blob(path, text) for path, text in files.items()}, "in git")
        assert not repository.head.files[SHARD].is_lfs
    server.faults.corrupt(f"*/{SHARD}", at=123_456)
    place = Path(fetch(server, tmp_path, script(BIG))[0])
    assert (place / SHARD).read_bytes() == CONTENT
    assert [request.sent for request in server.content_requests(SHARD)] == [len(CONTENT)] * 2


def test_a_card_that_cannot_be_adapted_stays_unchanged(server, tmp_path):
    card = b"---\ntags: " + b"[" * 900 + b"\n---\n"
    (tmp_path / "root" / NAME / "README.md").write_bytes(card)
    place = Path(fetch(server, tmp_path, script(NAME, "test", out=tmp_path / "out"))[0])
    assert (place / "README.md").read_bytes() == card


@pytest.mark.parametrize("to_folder", [False, True])
def test_a_byte_flipped_twice_is_an_error_and_leaves_nothing(server, tmp_path, to_folder):
    out = tmp_path / "out" if to_folder else None
    server.faults.corrupt(f"*/{SHARD}", at=123_456, times=2)
    code, kind, words = fetch(server, tmp_path, script(BIG, out=out))
    assert (code, kind) == (3, "IntegrityError")
    assert f"{SHARD!r} of Hub data set {BIG!r} arrived damaged twice" in words
    assert not [file for file in tmp_path.rglob("*") if file.is_file() and file.stat().st_size > 1_000_000]
    assert Path(fetch(server, tmp_path, script(BIG, out=out))[0], SHARD).read_bytes() == CONTENT


def test_a_full_disk_is_named_and_leaves_nothing(server, tmp_path):
    code, kind, words = fetch(server, tmp_path, script(BIG, before=FULL))
    assert (code, kind) == (2, "StorageError")
    assert "the disk cannot be written" in words
    left = [file for file in tmp_path.rglob("*") if file.is_file() and file.stat().st_size > 500_000]
    # Early releases of the client continue with what has arrived.
    assert {file.suffix for file in left} <= {".incomplete"}
    place = Path(fetch(server, tmp_path, script(BIG))[0])
    assert (place / SHARD).read_bytes() == CONTENT


def test_offline(server, tmp_path):
    (tmp_path / "other").mkdir()
    out, nowhere = tmp_path / "out", "http://127.0.0.1:9"
    fetch(server, tmp_path, script(NAME, "test"))
    fetch(server, tmp_path, script(BIG, out=out))
    before = folder_bytes(out)
    for more in ({}, {"HF_HUB_OFFLINE": "1"}):
        assert fetch(nowhere, tmp_path, script(NAME, "test"), **more)[3] is True
        code, kind, words = fetch(nowhere, tmp_path, script(BIG, out=out), **more)
        assert (code, kind) == (4, "HubError")
        assert "the present list of files of Hub data set 'someone/big' is not in the cache" in words
        code, kind, words = fetch(nowhere, tmp_path, script(NAME, "train"), **more)
        assert (code, kind) == (4, "HubError")
        assert (
            "'data/train-00000-of-00004.parquet' of Hub data set 'someone/toy' is not in the cache" in words
        )
        code, kind, words = fetch(nowhere, tmp_path / "other", script(BIG), **more)
        assert (code, kind) == (4, "HubError")
        assert "no connection to the Hub" in words
    assert "OfflineModeIsEnabled" in words
    assert folder_bytes(out) == before


def test_private_and_gated(server, tmp_path):
    token, stranger = server.account("someone"), server.account("else")
    server.repository(BIG).private = True
    assert "is private" in fetch(server, tmp_path, script(BIG))[2]
    out = tmp_path / "out"
    assert fetch(server, tmp_path, script(BIG, out=out), token)[0] == str(out)
    server.repository(BIG).private, server.repository(BIG).gated = False, "auto"
    assert "is gated" in fetch(server, tmp_path, script(BIG), stranger)[2]
    server.repository(BIG).granted.add("else")
    assert Path(fetch(server, tmp_path, script(BIG), stranger)[0], SHARD).read_bytes() == CONTENT
    assert {r.user for r in server.requests if r.path.startswith("/cdn/")} == {None}
    for file in [file for file in tmp_path.rglob("*") if file.is_file()]:
        assert token.encode() not in file.read_bytes(), file
        assert stranger.encode() not in file.read_bytes(), file
