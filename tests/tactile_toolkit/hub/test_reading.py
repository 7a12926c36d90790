"""Files of the Hub: complete or not at all, fetched once, and found by other programs too."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

from tests.hub_server import HubServer
from tests.processes import PATIENCE_S
from tests.tactile_toolkit.hub.client import run_here, settings, start_here
from tests.tactile_toolkit.hub.sets import BIG, CONTENT, NAME, SHARD, big_parquet, fetch, script

LOAD = """
from tactile_toolkit.errors import ToolkitError
from tactile_toolkit.hub.repository import open_repository
try:
    print('path', open_repository({name!r}).local_paths([{path!r}])[0])
except ToolkitError as error:
    print(error.exit_code, type(error).__name__, error)
"""


def load(server: HubServer | str, home: Path, name: str = BIG, path: str = SHARD, **more: str) -> str:
    done = run_here(LOAD.format(name=name, path=path), settings(server, home, **more), home)
    assert done.returncode == 0, done.stderr
    return done.stdout.strip()


def test_a_file_cut_short_in_the_cache_is_repaired_and_an_intact_one_is_not_fetched_again(server, tmp_path):
    file = Path(load(server, tmp_path).removeprefix("path "))
    load(server, tmp_path)
    assert len(server.content_requests(SHARD)) == 1
    file.resolve().write_bytes(CONTENT[:1000])
    assert Path(load(server, tmp_path).removeprefix("path ")).read_bytes() == CONTENT
    assert len(server.content_requests(SHARD)) == 2


COUNTED = """
import os
synced = set()
os.fsync = lambda handle: synced.add(os.fstat(handle).st_ino)
from tactile_toolkit.hub.repository import open_repository
(path,) = open_repository({name!r}).local_paths([{path!r}])
print(os.stat(path).st_ino in synced)
"""


def test_a_file_is_on_the_disk_before_it_counts_as_intact(server, tmp_path):
    done = run_here(COUNTED.format(name=BIG, path=SHARD), settings(server, tmp_path), tmp_path)
    assert done.stdout.strip() == "True", done.stderr


def test_files_that_the_manifest_does_not_list_are_refused(server, tmp_path):
    repository = server.repository(NAME)
    shard = "data/test-00000-of-00002.parquet"
    repository.commit({shard: repository.blob(shard, CONTENT)}, "another file")
    before = len(server.fetched)
    words = load(server, tmp_path, NAME, shard)
    assert words.startswith(f"3 IntegrityError {shard!r} of Hub data set {NAME!r} is not the file that")
    assert server.fetched[before:] == ["manifest.json"]


def test_a_manifest_of_other_tools_is_ignored(server, tmp_path):
    server.create("someone/other", {"manifest.json": b'{"name": "a web page"}', SHARD: CONTENT})
    assert load(server, tmp_path, "someone/other").startswith("path ")


def test_two_processes_fetch_a_file_once(server, tmp_path):
    server.faults.stall(f"*/{SHARD}", after=1_500_000)
    text, environment = LOAD.format(name=BIG, path=SHARD), settings(server, tmp_path)
    first, second = (start_here(text, environment, tmp_path) for _ in range(2))
    assert server.faults.stalled.wait(PATIENCE_S)
    server.faults.released.set()
    assert [process.end() for process in (first, second)] == [0, 0], first.err + second.err
    found = {first.out, second.out}
    assert len(found) == 1
    assert Path(found.pop().strip().removeprefix("path ")).read_bytes() == CONTENT
    assert [request.sent for request in server.content_requests(SHARD)] == [len(CONTENT)]


OTHERS = """
from huggingface_hub import HfApi, constants, hf_hub_download, scan_cache_dir, snapshot_download
found = scan_cache_dir(constants.HF_HUB_CACHE)
repos = list(found.repos)
print(len(found.warnings), [repo.repo_id for repo in repos], [repo.size_on_disk for repo in repos])
print(hf_hub_download('someone/big', 'data/train-00000-of-00001.parquet', repo_type='dataset'))
print(snapshot_download('someone/big', repo_type='dataset', local_files_only=True))
if hasattr(HfApi, 'verify_repo_checksums'):  # from 1.1 on
    proof = HfApi().verify_repo_checksums('someone/big', repo_type='dataset')
    assert proof.checked_count == 2 and not (proof.mismatches or proof.missing_paths or proof.extra_paths)
"""


def test_other_programs_find_the_files_in_the_cache_and_hf_cache_counts_them(server, tmp_path):
    place = fetch(server, tmp_path, script(BIG))[0]
    before = len(server.fetched)
    done = run_here(OTHERS, settings(server, tmp_path), tmp_path)
    size = len(CONTENT) + len(b"# Big")
    assert done.stdout.splitlines() == [f"0 ['{BIG}'] [{size}]", f"{place}/{SHARD}", place]
    assert len(server.fetched) == before


ADDRESS = """
from tactile_toolkit.hub.repository import open_repository
print(open_repository({name!r}).address({path!r}))
"""


def test_a_stream_stays_at_the_commit_that_it_began_with(server, tmp_path):
    def address() -> str:
        text = ADDRESS.format(name=BIG, path=SHARD)
        return run_here(text, settings(server, tmp_path), tmp_path).stdout.strip()

    before, repository = address(), server.repository(BIG)
    other = big_parquet(rows=5)
    repository.commit({SHARD: repository.blob(SHARD, other)}, "the branch moves on")
    assert address() != before
    assert stream(server, tmp_path, before) == "400000"
    assert stream(server, tmp_path, address()) == "5"


STREAM = """
from tactile_toolkit.errors import ToolkitError
from tactile_toolkit.places import open_place
try:
    (shard,) = open_place([{address!r}]).shards(streaming=True)
    {meanwhile}
    print(len(shard))
except ToolkitError as error:
    print(error.exit_code, type(error).__name__, error)
"""


def stream(server: HubServer | str, home: Path, address: str, meanwhile: str = "pass") -> str:
    done = run_here(STREAM.format(address=address, meanwhile=meanwhile), settings(server, home), home)
    return done.stdout.strip()


MOVES: list[Callable[[], None]] = []
MEANWHILE = "from tests.tactile_toolkit.hub import test_reading; test_reading.MOVES.pop()()"


def test_failures_of_streaming_are_named(server, tmp_path):
    address = f"hf://datasets/{BIG}@main/{SHARD}"
    assert stream(server, tmp_path, address) == "400000"
    MOVES.append(lambda: setattr(server.repository(BIG), "gated", "auto"))
    words = stream(server, tmp_path, address, MEANWHILE)
    assert words.startswith(f"4 HubError Hub data set {BIG!r} is gated; next: ")
