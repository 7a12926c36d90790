"""Folders in an object store, tested with an S3 server on this machine."""

from __future__ import annotations

import io
import socket
import subprocess
import sys
import tempfile
import threading
from collections import Counter
from dataclasses import replace
from pathlib import Path

import pytest

from tactile_toolkit.errors import InputError, IntegrityError, RemoteError
from tactile_toolkit.run.runners import ProcessRunner
from tactile_toolkit.store import build, open_folder, read_manifest, remote, verify
from tests.tactile_toolkit.toy import SCHEMA, folder_bytes, toy_plan

pytestmark = pytest.mark.s3
pytest.importorskip("s3fs")
pytest.importorskip("moto")

from tests.s3_server import KEY, SECRET  # noqa: E402


@pytest.fixture
def folder(bucket):
    return open_folder(f"s3://{bucket}/deep/set")


def test_written_files_are_listed_with_their_size_and_read_again(folder):
    assert (folder.exists(), folder.names(), folder.sizes("data")) == (False, [], {})
    folder.require_folder()
    folder.write_bytes("data/a", b"12345")
    folder.write_bytes("manifest.json", b"{}")
    assert folder.exists()
    assert folder.exists("data")
    assert not folder.exists("dat")
    assert folder.names() == ["data", "manifest.json"]
    assert folder.sizes() == {"manifest.json": 2}
    assert folder.sizes("data") == {"a": 5}
    assert folder.sizes("data/a") == {}
    assert folder.size_bytes("data/a") == 5
    with folder.open("data/a") as stream:
        stream.seek(-3, io.SEEK_END)
        assert (stream.read(2), stream.tell(), stream.read()) == (b"34", 4, b"5")
    folder.remove("data/a")
    folder.remove("data/a")
    assert folder.names() == ["manifest.json"]
    with pytest.raises(IntegrityError, match=r"cannot read 's3://.*data/a'"):
        folder.read_bytes("data/a")


def test_a_file_of_several_megabytes_is_one_request(folder, s3, bucket):
    content = bytes(101 << 20)  # more than the client sends in one piece
    s3.traffic.reset()
    folder.write_bytes("data/large", content)
    assert s3.traffic.requests["PUT"] == 1
    assert s3.traffic.requests["POST"] == 0
    assert folder.size_bytes("data/large") == len(content)


def test_a_failed_upload_of_a_large_file_leaves_no_pieces(folder, s3, bucket, tmp_path):
    with (tmp_path / "report").open("wb") as file:
        file.truncate(101 << 20)
    s3.refuse = lambda asked: (
        ("403 Forbidden", "AccessDenied") if "partNumber=3" in asked["QUERY_STRING"] else None
    )
    with pytest.raises(RemoteError, match="AccessDenied"):
        folder.upload("reports/large", tmp_path / "report")
    assert s3.traffic.requests["POST"] == 1  # its upload was begun in pieces
    assert s3.uploads(bucket) == []
    assert folder.names("reports") == []


def test_files_of_other_clients_are_seen_at_once(folder, s3, bucket):
    folder.write_bytes("data/a", b"1")
    assert folder.names("data") == ["a"]
    import boto3

    other = boto3.client("s3", endpoint_url=s3.endpoint)
    other.put_object(Bucket=bucket, Key="deep/set/data/b", Body=b"22")
    assert folder.sizes("data") == {"a": 1, "b": 2}
    other.delete_object(Bucket=bucket, Key="deep/set/data/a")
    assert folder.names("data") == ["b"]
    assert not folder.exists("data/a")


def _open(folder):
    with folder.open("data/a") as stream:
        return stream.read()


@pytest.mark.parametrize(
    ("method", "act"),
    [
        ("GET", lambda folder: folder.read_bytes("data/a")),
        ("GET", _open),
        ("GET", lambda folder: folder.names()),
        ("GET", lambda folder: folder.download("data/a", Path(tempfile.mkdtemp()) / "a")),
    ],
)
def test_an_answer_that_comes_byte_by_byte_is_given_up(folder, s3, monkeypatch, method, act):
    """Each byte arrives within the limit of the client, which applies to each part of a reply."""
    folder.write_bytes("data/a", bytes(600))
    expected = act(folder)
    s3.slow = lambda environ: 0.05 * (environ["REQUEST_METHOD"] == method)
    monkeypatch.setattr(remote, "ANSWER_S", 0.2)
    monkeypatch.setattr(remote, "_WAITS_S", (0.01,))
    with pytest.raises(RemoteError, match=r"gives no answer \(no whole answer within 0\.2.* s\)"):
        act(folder)
    s3.slow = lambda _: 0.0
    assert act(folder) == expected


@pytest.mark.usefixtures("new_clients")
def test_a_request_that_is_lost_is_made_again(folder, s3, monkeypatch):
    """Requests without a reply are ended by the time limit of the client."""
    assert 2 * remote._LIMITS["read_timeout"] < remote._PATIENCE_S
    monkeypatch.setitem(remote._LIMITS, "read_timeout", 0.2)
    folder.write_bytes("data/a", b"1")
    s3.traffic.reset()
    s3.slow = lambda environ: environ["REQUEST_METHOD"] == "GET" and s3.traffic.requests["GET"] == 1
    assert folder.read_bytes("data/a") == b"1"
    assert s3.traffic.requests["GET"] == 2


def test_of_many_writers_at_once_one_creates_a_file(folder):
    found = []

    def create(number):
        folder.create_bytes("plan.json", b"%d" % number)
        found.append(folder.read_bytes("plan.json"))

    threads = [threading.Thread(target=create, args=(number,)) for number in range(8)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert len(found) == 8
    assert len(set(found)) == 1


def test_a_creation_whose_answer_was_lost_is_not_a_failure(folder, s3):
    folder.exists()  # the store has replied once
    state = {"put": 0}

    def lose(environ):
        state["put"] += environ["REQUEST_METHOD"] == "PUT"
        if environ["REQUEST_METHOD"] == "PUT" and state["put"] == 1:
            s3.refuse = lambda _: None
            boto_put(s3, "deep/set/plan.json", b"mine", folder)
            return "500 Internal Server Error", "InternalError"
        return None

    s3.refuse = lose
    folder.create_bytes("plan.json", b"mine")
    folder.create_bytes("plan.json", b"other")
    assert folder.read_bytes("plan.json") == b"mine"


def boto_put(s3, key, body, folder):
    import boto3

    boto3.client("s3", endpoint_url=s3.endpoint).put_object(
        Bucket=folder.root.split("/")[2], Key=key, Body=body
    )


@pytest.mark.parametrize(
    "act", [lambda folder: folder.require_folder(), lambda folder: folder.write_bytes("a", b"1")]
)
def test_no_bucket_is_ever_made(s3, act):
    before = s3.buckets()
    with pytest.raises(
        InputError, match=r"bucket 'mistyped' of 's3://mistyped/set' does not exist; .*; next: "
    ):
        act(open_folder("s3://mistyped/set"))
    assert s3.buckets() == before
    assert (
        open_folder("s3://mistyped/set").missing_message("data")
        == "the bucket 'mistyped' of 's3://mistyped/set' does not exist"
    )


def test_a_file_in_the_place_of_the_folder_is_refused(folder, bucket):
    folder.write_bytes("data/a", b"1")
    with pytest.raises(InputError, match="is a file; expected a folder"):
        open_folder(f"{folder.root}/data/a").require_folder()


def test_transient_failures_are_retried(folder, s3):
    answers = iter([("503 Slow Down", "SlowDown")] * 2)
    s3.refuse = lambda _: next(answers, None)
    folder.write_bytes("a", b"1")
    assert folder.read_bytes("a") == b"1"


def test_a_refusal_is_named_at_once_and_no_file_counts_as_missing(folder, s3):
    """``test_retries.py`` tests the codes; here, a request for one file gets a status."""
    folder.write_bytes("a", b"1")
    s3.refuse = lambda _: ("403 Forbidden", "AccessDenied")
    for act in (folder.names, lambda: folder.write_bytes("b", b"1")):
        with pytest.raises(RemoteError, match=r"is refused \(AccessDenied.*; next: ") as told:
            act()
        assert told.value.exit_code == 4
    for act in (folder.exists, lambda: folder.read_bytes("a"), folder.require_folder):
        with pytest.raises(RemoteError, match=r"; next: ") as told:
            act()
        assert not {KEY, SECRET} & set(str(told.value).split())


@pytest.mark.parametrize(
    "act",
    [
        lambda folder: folder.names("data") == ["a"],
        lambda folder: folder.read_bytes("data/a") == b"1" * 999,
        lambda folder: folder.open("data/a").read() == b"1" * 999,
    ],
)
def test_an_answer_that_ends_too_early_is_asked_for_again(folder, s3, act):
    folder.write_bytes("data/a", b"1" * 999)
    asked = []

    def shorten(environ):
        asked.append(environ["REQUEST_METHOD"])
        return 50 if asked.count("GET") == 1 and asked[-1] == "GET" else None

    s3.shorten = shorten
    assert act(folder)
    assert asked.count("GET") == 2


def test_a_status_without_a_reason_names_the_region(folder, s3):
    """A request for one file of a bucket in another region gets a reply without a body that explains it."""
    folder.write_bytes("a", b"1")
    s3.refuse = lambda _: ("400 Bad Request", "AuthorizationHeaderMalformed")
    for act in (folder.exists, lambda: folder.exists("a"), lambda: folder.read_bytes("a")):
        with pytest.raises(RemoteError, match=r"region.*; next: set AWS_DEFAULT_REGION"):
            act()
    s3.refuse = lambda _: ("301 Moved Permanently", "PermanentRedirect")
    with pytest.raises(RemoteError, match=r"region.*; next: set AWS_DEFAULT_REGION"):
        folder.names()


def test_a_file_that_is_replaced_while_it_is_read_is_not_read_on(folder):
    folder.write_bytes("a", b"1" * (5 << 20))
    with folder.open("a") as stream:
        assert stream.read(3) == b"111"
        folder.write_bytes("a", b"2" * (5 << 20))
        stream.seek(4 << 20)
        with pytest.raises(IntegrityError, match="was replaced while it was read"):
            stream.read(3)


@pytest.mark.usefixtures("new_clients")
def test_a_store_that_is_not_there_is_named_in_bounded_time(s3, monkeypatch, capfd):
    monkeypatch.setattr(remote, "_PATIENCE_S", 1.0)
    monkeypatch.setenv("AWS_ENDPOINT_URL", "http://127.0.0.1:9")
    with pytest.raises(
        RemoteError, match=r"store of 's3://lake/set' gives no answer.*AWS_ENDPOINT_URL"
    ) as told:
        open_folder("s3://lake/set").names()
    assert told.value.exit_code == 4
    assert capfd.readouterr() == ("", "")


@pytest.mark.usefixtures("new_clients")
def test_without_credentials_the_way_to_give_some_is_named(s3, monkeypatch, tmp_path):
    for name in ("AWS_ACCESS_KEY_ID", "AWS_SECRET_ACCESS_KEY"):
        monkeypatch.delenv(name)
    monkeypatch.setenv("AWS_CONFIG_FILE", str(tmp_path / "none"))
    monkeypatch.setenv("AWS_SHARED_CREDENTIALS_FILE", str(tmp_path / "none"))
    with pytest.raises(RemoteError, match=r"is refused.*next: give credentials.*AWS_PROFILE"):
        open_folder("s3://lake/set").names()


def wide_plan(rows=2_000):
    """Four shards of some hundred kilobytes each."""
    plan = toy_plan(("train",))
    tasks = tuple(
        replace(task, ids=tuple(10 * number + 3 for number in range(index * rows, (index + 1) * rows)))
        for index, task in enumerate(plan.tasks)
    )
    return replace(plan, tasks=tasks)


def test_a_run_over_a_finished_set_reads_almost_none_of_it(folder, s3, bucket):
    written = []
    made = build(folder, wide_plan(), write_card=lambda *_: written.append("card"))
    size = sum(map(len, s3.objects(bucket).values()))
    before = s3.objects(bucket)
    s3.traffic.reset()
    assert build(folder, wide_plan(), write_card=lambda *_: written.append("card")) == made
    assert s3.traffic.sent_bytes < 0.01 * size, (s3.traffic, size)
    assert s3.traffic.requests["PUT"] == 0
    assert written == ["card"]
    assert s3.objects(bucket) == before
    # Missing files and those of another size are made again.
    folder.write_bytes("data/train-00001-of-00004.parquet", b"cut")
    folder.remove("data/train-00002-of-00004.parquet")
    assert build(folder, wide_plan()) == made
    assert s3.objects(bucket) == before


def test_verify_brings_each_shard_once(folder, s3):
    manifest = build(folder, wide_plan())
    size = sum(record.bytes for record in manifest.shards)
    s3.traffic.reset()
    result = verify(folder, SCHEMA, workers=2)
    assert result.ok
    asked = Counter(path for path in s3.traffic.paths if path.startswith("GET") and "/data/" in path)
    assert list(asked.values()) == [1] * len(manifest.shards)
    assert s3.traffic.sent_bytes < 1.5 * size
    first, second, third = (f"data/train-{index:05d}-of-00004.parquet" for index in range(3))
    folder.write_bytes(first, folder.read_bytes(second))
    folder.remove(third)
    found = {finding.file: finding.problem for finding in verify(folder, SCHEMA, workers=2).findings}
    assert found[first].startswith("sha256 is")
    assert found[third] == "is missing"


@pytest.mark.usefixtures("new_clients")
@pytest.mark.filterwarnings("ignore::ResourceWarning")
def test_a_store_that_never_replies_is_named(s3, monkeypatch):
    """The first request ends at the time limit, which is one second here instead of twenty."""
    monkeypatch.setitem(remote._LIMITS, "read_timeout", 1)
    monkeypatch.setattr(remote, "_PATIENCE_S", 1.0)
    with socket.create_server(("127.0.0.1", 0)) as silent:
        monkeypatch.setenv("AWS_ENDPOINT_URL", f"http://127.0.0.1:{silent.getsockname()[1]}")
        folder = open_folder("s3://lake/set")
        for act in (folder.names, folder.require_folder, lambda: folder.read_bytes("manifest.json")):
            with pytest.raises(RemoteError, match=r"gives no answer \(.*[Tt]imeout.*; next: ") as told:
                act()
            assert told.value.exit_code == 4


_KILLED = """
import os, signal, sys
from tactile_toolkit.run.runners import ProcessRunner
from tactile_toolkit.store.building import build
from tactile_toolkit.store import open_folder
from tests.tactile_toolkit.toy import toy_plan
def die(progress):
    if progress.done >= 10:
        os.kill(os.getpid(), signal.SIGKILL)
build(open_folder(sys.argv[1]), toy_plan(pause_s=0.2), workers=ProcessRunner(2), on_progress=die)
"""


def test_a_killed_run_is_resumed_by_two_workers_to_the_same_bytes(folder, s3, bucket, tmp_path):
    done = subprocess.run([sys.executable, "-c", _KILLED, folder.root], check=False)
    assert done.returncode == -9
    assert any(name.endswith(".json") for name in folder.names(".pending"))
    assert not read_manifest(folder).complete
    build(folder, toy_plan(), workers=ProcessRunner(2))
    build(open_folder(str(tmp_path)), toy_plan())
    # Workers of the killed run may live on for a moment; they write the same bytes again.
    stored = {key.removeprefix("deep/set/"): content for key, content in s3.objects(bucket).items()}
    assert stored == folder_bytes(tmp_path)
    assert s3.uploads(bucket) == []
