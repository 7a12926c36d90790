"""A Hub that sends too much, too slowly, or something else: each case ends soon, with a message."""

from __future__ import annotations

import gzip
import inspect
import json
import time
from pathlib import Path

import huggingface_hub
import pytest

from tactile_toolkit.hub import calls
from tactile_toolkit.store import remote
from tactile_toolkit.store.remote import ASKED_WAIT_S
from tests.tactile_toolkit.hub import client
from tests.tactile_toolkit.hub.client import run_here, run_python, settings
from tests.tactile_toolkit.hub.sets import BIG, CONTENT, SHARD, fetch, script

resource = pytest.importorskip("resource")

LISTING = f"/api/datasets/{BIG}*"


def files_below(folder: Path) -> list[Path]:
    return [file for file in folder.rglob("*") if file.is_file() and file.suffix != ".lock"]


@pytest.mark.skipif(
    "tqdm_class" not in inspect.signature(huggingface_hub.hf_hub_download).parameters,
    reason="early clients do not report what arrives",
)
@pytest.mark.parametrize("to_folder", [False, True])
def test_a_file_without_end_is_given_up_at_the_size_that_the_listing_states(server, tmp_path, to_folder):
    out = tmp_path / "out" if to_folder else None
    server.faults.endless("/cdn/*parquet")
    code, kind, words = fetch(server, tmp_path, script(BIG, out=out))
    assert (code, kind) == (4, "HubError")
    assert f"(TooLargeError: more than the {len(CONTENT):,} bytes that were expected)" in words
    assert SHARD in words
    kept = sum(file.stat().st_size for file in files_below(tmp_path) if "root" not in file.parts)
    assert kept < len(CONTENT), "what arrived too much lies on the disk"
    assert fetch(server, tmp_path, script(BIG, out=out))[1] == [SHARD]


def test_a_listing_that_unpacks_to_gigabytes_ends_soon(server, tmp_path, monkeypatch):
    # A thousandth of the real work, with a limit a thousand times smaller.
    monkeypatch.setattr(calls, "ANSWER_BYTES", 1 << 20)
    packed = gzip.compress(b"[" + b" " * (64 << 20))
    headers = {"Content-Encoding": "gzip", "Content-Type": "application/json"}
    server.faults.fail(LISTING, 200, value=packed, headers=headers)
    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    code, kind, words = fetch(server, tmp_path, script(BIG))
    assert (code, kind) == (4, "HubError")
    assert "more than the 1,048,576 bytes that were expected" in words
    assert "; next: " in words
    assert resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before < 32 << 10  # in KiB


@pytest.mark.parametrize("head", [False, True])
@pytest.mark.parametrize(
    ("pattern", "doing"), [(LISTING, "reading"), ("/cdn/*parquet", f"fetching {SHARD!r} of")]
)
def test_an_answer_that_comes_byte_by_byte_is_given_up(server, tmp_path, monkeypatch, pattern, doing, head):
    """Each byte arrives within the limit of the client, which applies to each part of a reply."""
    if not head and not hasattr(huggingface_hub, "close_session"):
        pytest.skip("clients before 1.0 do not tell what arrives of a body")
    monkeypatch.setattr(remote, "ANSWER_S", 0.3)
    server.faults.drip(pattern, 0.05, times=99, head=head)
    code, kind, words = fetch(server, tmp_path, script(BIG))
    assert (code, kind) == (4, "HubError")
    assert f"no connection to the Hub at {server.endpoint} while {doing} Hub data set" in words
    assert "(TooSlowError: " in words
    assert "run the same command again, it continues" in words
    server.faults.clear()
    monkeypatch.undo()
    assert fetch(server, tmp_path, script(BIG))[1][-1] == SHARD


PAGE = b"<!DOCTYPE html><title>Hotel</title><form>Please log in</form>"


@pytest.mark.parametrize(
    ("value", "kind"),
    [
        (PAGE, "text/html"),
        (b"", "application/json"),
        (b"[]", "application/json"),
        (b'["a"]', "application/json"),
        (b"7", "application/json"),
        (b"{}", "application/json"),
        (b'{"id": 1, "siblings": 7}', "application/json"),
        (b"[" * 100_000, "application/json"),
    ],
)
def test_replies_of_other_servers_are_named(server, tmp_path, value, kind):
    server.faults.fail(LISTING, 200, times=99, value=value, headers={"Content-Type": kind})
    code, error, words = fetch(server, tmp_path, script(BIG))
    assert (code, error) == (4, "HubError")
    assert f"{server.endpoint} does not answer as a Hub does while reading Hub data set" in words
    assert "; next: check HF_ENDPOINT" in words
    asked = [request for request in server.requests if "/datasets/" in request.path]
    assert len(asked) == 1, "what does not pass was tried again"


WAITS = [
    {"Retry-After": "86400"},
    {"Retry-After": "9" * 5000},
    {"RateLimit": '"api";r=0;t=86400'},
    {"RateLimit": '"api";r=0;t=' + "9" * 5000},
]


@pytest.mark.parametrize("headers", WAITS)
@pytest.mark.parametrize("pattern", [LISTING, "/cdn/*parquet"])
def test_a_hub_that_asks_for_a_long_wait_is_not_waited_for(server, tmp_path, monkeypatch, pattern, headers):
    slept: list[float] = []
    monkeypatch.setattr(time, "sleep", slept.append)
    monkeypatch.setattr(client._NoWaits, "sleep", slept.append)
    server.faults.fail(pattern, 429, times=99, headers=headers)
    code, kind, words = fetch(server, tmp_path, script(BIG))
    assert (code, kind) == (4, "HubError")
    assert "the Hub answered 429" in words
    assert "next: try again in " in words
    assert sum(slept) <= ASKED_WAIT_S
    assert "86400 s" in words or "999" in words or "1000000000 s" in words


def test_short_waits_that_the_hub_asks_for_end_together(server, tmp_path, monkeypatch):
    slept: list[float] = []
    monkeypatch.setattr(time, "sleep", slept.append)
    server.faults.fail(LISTING, 429, times=99, headers={"Retry-After": "50"})
    before = "from tactile_toolkit.hub import calls; calls.WAITS_S = (1.0,) * 6\n"
    done = run_here(script(BIG, before=before), settings(server, tmp_path), tmp_path)
    assert json.loads(done.stdout.splitlines()[-1])[:2] == [4, "HubError"]
    assert slept == [50.0, 50.0]


def test_an_exit_in_a_thread_ends_the_download(server, tmp_path):
    """A closed pipe raises SystemExit where a message is written, also in a thread of a download."""
    code = f"""
from tactile_toolkit import hub
repository = hub.open_repository({BIG!r})
def closed(_):
    raise SystemExit(141)
repository.fetch([repository.file({SHARD!r})], on_bytes=closed)
"""
    assert run_python(code, settings(server, tmp_path), tmp_path).returncode == 141
