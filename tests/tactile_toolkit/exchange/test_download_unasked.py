"""Downloads without a connection to the Hub: files that the cache does not list may exist, and are kept."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import pytest

from tactile_toolkit.store import open_folder, read_download_record
from tests.hub_server import HubServer
from tests.tactile_toolkit.hub.sets import NAME, big_parquet, fetch, script, two_sets
from tests.tactile_toolkit.toy import folder_bytes

BARE = "someone/bare"
TEST, TRAIN = (f"data/{split}-00000-of-00001.parquet" for split in ("test", "train"))
NOWHERE = "http://127.0.0.1:9"
OFFLINE = {"HF_HUB_OFFLINE": "1"}


@pytest.fixture
def server(tmp_path) -> Iterator[HubServer]:
    with two_sets(tmp_path / "root") as running:
        files = {"README.md": b"# Bare", TEST: big_parquet(1)[:9_000], TRAIN: big_parquet(2)[:9_000]}
        running.create(BARE, files)
        yield running


@pytest.fixture
def out(server, tmp_path) -> Path:
    """A folder with both splits, while the cache has one of them."""
    fetch(server, tmp_path, script(BARE, "test"))
    fetch(server, tmp_path, script(BARE, out=tmp_path / "out"))
    return tmp_path / "out"


def flip_a_byte(file: Path) -> None:
    content = bytearray(file.read_bytes())
    content[500] ^= 1
    file.write_bytes(content)


@pytest.mark.parametrize("more", [{}, OFFLINE])
@pytest.mark.parametrize("damage", ["README.md", TEST])
def test_a_folder_is_unchanged_while_the_hub_does_not_reply(out, tmp_path, more, damage):
    (out / damage).unlink()
    before = folder_bytes(out)
    code, kind, words = fetch(NOWHERE, tmp_path, script(BARE, out=out), **more)
    assert (code, kind) == (4, "HubError")
    assert f"the present list of files of Hub data set {BARE!r} is not in the cache" in words
    assert folder_bytes(out) == before


def test_a_hub_in_trouble_is_waited_for_where_the_cache_is_not_enough(server, out, tmp_path):
    before = folder_bytes(out)
    flip_a_byte(out / TRAIN)
    server.faults.fail("/api/datasets/*", 503, times=2)
    _, missing, leftover, _ = fetch(server, tmp_path, script(BARE, out=out))
    assert (missing, leftover) == ([TRAIN], [])
    assert folder_bytes(out) == before
    server.faults.fail("/api/datasets/*", 503, times=1)
    _, missing, _, _ = fetch(server, tmp_path, script(BARE))
    assert missing == [TRAIN], "the splits of the cache were taken for all"


def test_a_download_whose_card_did_not_arrive_is_not_done(server, tmp_path):
    out = tmp_path / "toy"
    fetch(server, tmp_path, script(NAME, out=out))
    repository = server.repository(NAME)
    repository.commit({"README.md": repository.blob("README.md", b"# Newer")}, "words")
    server.faults.fail("*/README.md", 503, times=99)
    assert fetch(server, tmp_path, script(NAME, out=out))[0] == 4
    server.faults.clear()
    record = read_download_record(open_folder(str(out)))
    assert record is not None
    assert not record.finished
    assert fetch(server, tmp_path, script(NAME, out=out))[3] is False
    assert (out / "README.md").read_bytes() == b"# Newer"
    assert fetch(server, tmp_path, script(NAME, out=out))[3] is True
