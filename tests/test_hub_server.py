"""The server against the unmodified clients: what it keeps, what it sends, and that its faults are real."""

from __future__ import annotations

import hashlib
import io
import json
import subprocess
import urllib.error
import urllib.request
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from tests.hub_server import HubServer, hub
from tests.hub_server.repositories import git_blob_oid
from tests.tactile_toolkit.hub.client import run_here, run_python, settings

LARGE = bytes(range(256)) * 4096
"""One MiB that is kept as a large file."""


@pytest.fixture
def server() -> Iterator[HubServer]:
    with hub() as running:
        yield running


def client(
    script: str, server: HubServer, home: Path, token: str | None = None, **more: str
) -> subprocess.CompletedProcess[str]:
    """Run a script that uses the client library."""
    head = "import json, huggingface_hub as hub\nfrom huggingface_hub import HfApi, errors\napi = HfApi()\n"
    return run_here(head + script, settings(server, home, token, **more), home)


def answer(script: str, server: HubServer, home: Path, token: str | None = None, **more: str) -> Any:
    done = client(f"print(json.dumps(({script})))", server, home, token, **more)
    assert done.returncode == 0, done.stderr
    return json.loads(done.stdout.splitlines()[-1])


def failure(script: str, server: HubServer, home: Path, token: str | None = None, **more: str) -> str:
    """Return the name of the exception that a client raises."""
    done = client(
        f"try:\n    {script}\nexcept Exception as e:\n    r = getattr(e, 'response', None)\n"
        "    print(type(e).__name__, r.status_code if r is not None else '')",
        server,
        home,
        token,
        **more,
    )
    assert done.returncode == 0, done.stderr
    return done.stdout.strip()


@pytest.fixture
def folder(tmp_path) -> Path:
    place = tmp_path / "folder"
    (place / "data").mkdir(parents=True)
    (place / "README.md").write_text("---\nlicense: mit\n---\n# A set\n")
    (place / "data" / "train-00000-of-00001.parquet").write_bytes(LARGE)
    return place


UPLOAD = """
api.create_repo('someone/set', repo_type='dataset', private={private}, exist_ok=True)
info = api.upload_folder(repo_id='someone/set', repo_type='dataset', folder_path='folder',
                         commit_message='All of it', commit_description='why', create_pr={pull})
print(info.oid, info.pr_num)
"""


def test_a_folder_is_uploaded_once(server, tmp_path, folder):
    token = server.account("someone")
    done = client(UPLOAD.format(private=True, pull=False), server, tmp_path, token)
    repository = server.repository("someone/set")
    assert repository.private
    assert repository.head.sha == done.stdout.split()[0]
    assert (repository.head.title, repository.head.description) == ("All of it", "why")
    assert repository.head.files["data/train-00000-of-00001.parquet"].content == LARGE
    assert repository.head.files["README.md"].content == (folder / "README.md").read_bytes()
    sent = [request.received for request in server.requests if request.method == "PUT"]
    assert sent == [len(LARGE)]
    again = client(UPLOAD.format(private=True, pull=False), server, tmp_path, token)
    assert again.stdout.split()[0] == repository.head.sha
    assert sum(request.method == "PUT" for request in server.requests) == 1
    assert len(repository.history) == 2


def test_pull_request(server, tmp_path, folder):
    server.create("someone/set")
    stranger = server.account("else")
    # Another user may open a pull request, but not make the repository.
    script = UPLOAD.format(private=False, pull=True).replace("api.create_repo", "str or api.create_repo")
    script = script.partition("\n")[2].partition("\n")[2]
    done = client(script, server, tmp_path, stranger)
    assert done.stdout.split()[1] == "1"
    repository = server.repository("someone/set")
    assert not repository.head.files
    pulled = repository.find("refs/pr/1")
    assert pulled is not None
    assert "README.md" in pulled.files
    files = "api.list_repo_files('someone/set', repo_type='dataset', revision='refs/pr/1')"
    assert "README.md" in answer(files, server, tmp_path)


def test_content_that_is_not_what_was_announced_is_refused(server):
    server.create("someone/set")
    place = f"{server.cdn}/lfs/datasets/someone/set/{hashlib.sha256(b'right').hexdigest()}"
    with pytest.raises(urllib.error.HTTPError) as refused:
        urllib.request.urlopen(urllib.request.Request(place, b"wrong", method="PUT"))
    refused.value.close()
    assert refused.value.code == 400


def test_history_names_and_deletion(server, tmp_path):
    token = server.account("someone")
    server.create("someone/set", {"a.txt": b"1", "data/b.txt": b"2"})
    first = server.repository("someone/set").head.sha
    script = """
from pathlib import Path
r = dict(repo_id='someone/set', repo_type='dataset')
api.create_tag(**r, tag='v1')
api.create_branch(**r, branch='work/new')
api.upload_file(path_or_fileobj=b'3', path_in_repo='a.txt', revision='work/new', **r)
api.delete_file('data/b.txt', **r)
refs = api.list_repo_refs(**r)
get = lambda revision: Path(hub.hf_hub_download(**r, filename='a.txt', revision=revision)).read_text()
print(json.dumps({
    'main': api.list_repo_files(**r), 'tag': api.list_repo_files(**r, revision='v1'),
    'branches': [b.name for b in refs.branches], 'tags': {t.name: t.target_commit for t in refs.tags},
    'titles': [c.title for c in api.list_repo_commits(**r)],
    'new': get('work/new'), 'old': get('v1'),
}))
"""
    found = json.loads(client(script, server, tmp_path, token).stdout)
    assert found["main"] == ["a.txt"]
    assert found["tag"] == ["a.txt", "data/b.txt"]
    assert found["branches"] == ["main", "work/new"]
    assert found["tags"] == {"v1": first}
    assert found["titles"][1:] == ["files", "initial commit"]
    assert (found["new"], found["old"]) == ("3", "1")
    refused = failure(
        "api.create_commit('someone/set', [hub.CommitOperationDelete('a.txt')], commit_message='x',"
        f" repo_type='dataset', parent_commit='{first}')",
        server,
        tmp_path,
        token,
    )
    assert refused == "HfHubHTTPError 412"


def test_listing_says_what_the_content_is(server, tmp_path):
    files = {f"data/{index:02d}.txt": b"%d" % index for index in range(7)}
    server.create("someone/set", {**files, "big.parquet": LARGE})
    server.page_size = 3
    script = "[[f.path, f.size, f.blob_id, f.lfs and f.lfs.sha256] for f in {} if hasattr(f, 'size')]"
    tree = "api.list_repo_tree('someone/set', recursive=True, repo_type='dataset')"
    listed = answer(script.format(tree), server, tmp_path)
    expected = [[path, len(text), git_blob_oid(text), None] for path, text in files.items()]
    assert listed[1:] == expected
    assert listed[0][3] == hashlib.sha256(LARGE).hexdigest()
    assert sum("/tree/" in request.path for request in server.requests) == 3
    info = "api.get_paths_info('someone/set', ['big.parquet', 'data/03.txt', 'no'], repo_type='dataset')"
    assert answer(script.format(info), server, tmp_path) == [listed[0], expected[3]]
    siblings = "[s.size for s in api.dataset_info('someone/set', files_metadata=True).siblings]"
    assert answer(siblings, server, tmp_path) == [len(LARGE), *[1] * 7]


FETCH = "hub.hf_hub_download('someone/set', 'big.parquet', repo_type='dataset')"


def test_large_files_come_from_elsewhere_without_the_token(server, tmp_path):
    token = server.account("someone")
    server.create("someone/set", {"big.parquet": LARGE}, private=True)
    assert Path(answer(FETCH, server, tmp_path, token)).read_bytes() == LARGE
    users = {r.path.split("/")[1]: r.user for r in server.requests if r.is_content}
    assert users == {"datasets": "someone", "cdn": None}
    assert server.fetched == ["big.parquet"]


def test_snapshot(server, tmp_path):
    files = {"README.md": b"# A", "big.parquet": LARGE, "data/x.txt": b"x"}
    server.create("someone/set", files)
    place = Path(answer("hub.snapshot_download('someone/set', repo_type='dataset')", server, tmp_path))
    assert {str(f.relative_to(place)): f.read_bytes() for f in place.rglob("*") if f.is_file()} == files


@pytest.mark.parametrize(
    ("owner", "role", "expected"),
    [
        (None, "", "RepositoryNotFoundError 401"),
        ("else", "write", "RepositoryNotFoundError 404"),
        ("someone", "read", ""),
    ],
)
def test_private(server, tmp_path, owner, role, expected):
    server.create("someone/set", {"big.parquet": LARGE}, private=True)
    token = server.account(owner, role) if owner else None
    assert failure(FETCH, server, tmp_path, token) == expected


def test_gated(server, tmp_path):
    repository = server.create("someone/set", {"big.parquet": LARGE}, gated="auto")
    assert failure(FETCH, server, tmp_path) == "GatedRepoError 401"
    token = server.account("else")
    assert failure(FETCH, server, tmp_path, token) == "GatedRepoError 403"
    repository.granted.add("else")
    assert failure(FETCH, server, tmp_path, token) == ""
    assert answer("api.dataset_info('someone/set').gated", server, tmp_path) == "auto"


PUT = "api.upload_file(path_or_fileobj=b'1', path_in_repo='a', repo_id='someone/set', repo_type='dataset')"


def test_who_may_write(server, tmp_path):
    server.create("someone/set")
    create = "api.create_repo('someone/{}', repo_type='dataset')"
    assert failure(create.format("new"), server, tmp_path) == "HfHubHTTPError 401"
    assert failure(create.format("new"), server, tmp_path, server.account("someone", "read")).endswith("403")
    assert failure(create.format("new"), server, tmp_path, server.account("else")).endswith("403")
    token = server.account("someone")
    assert failure(create.format("set"), server, tmp_path, token) == "HfHubHTTPError 409"
    assert failure(create.format("new"), server, tmp_path, token) == ""
    assert answer("api.whoami()['name']", server, tmp_path, token) == "someone"
    assert failure(PUT, server, tmp_path, server.account("else")) == "HfHubHTTPError 403"


def test_a_bad_token_is_refused_even_for_what_is_public(server, tmp_path):
    server.create("someone/set", {"big.parquet": LARGE})
    assert failure(FETCH, server, tmp_path, "hf_nobodyhasthis") == "HfHubHTTPError 401"
    assert {request.user for request in server.requests if "someone/set" in request.path} == {"?"}


def test_a_dropped_answer_is_asked_for_again(server, tmp_path):
    server.create("someone/set", {"big.parquet": LARGE})
    server.faults.drop("*/big.parquet", after=300_000)
    assert Path(answer(FETCH, server, tmp_path)).read_bytes() == LARGE
    assert [request.sent for request in server.content_requests("big.parquet")] == [300_000, len(LARGE)]


def test_a_part_is_sent_where_a_part_is_asked_for(server):
    server.create("someone/set", {"big.parquet": LARGE})
    place = f"{server.endpoint}/datasets/someone/set/resolve/main/big.parquet"
    for span, expected in (("bytes=1000-", LARGE[1000:]), ("bytes=5-9", LARGE[5:10])):
        with urllib.request.urlopen(urllib.request.Request(place, headers={"Range": span})) as part:
            assert (part.status, part.read()) == (206, expected)
    assert [request.sent for request in server.content_requests("big.parquet")] == [len(LARGE) - 1000, 5]


def test_what_the_clients_do_not_notice(server, tmp_path):
    server.create("someone/set", {"big.parquet": LARGE})
    server.faults.corrupt("*/big.parquet", at=1000)
    damaged = Path(answer(FETCH, server, tmp_path)).read_bytes()
    assert [i for i, (a, b) in enumerate(zip(damaged, LARGE, strict=True)) if a != b] == [1000]


def test_what_the_clients_give_up_on(server, tmp_path):
    server.create("someone/set", {"big.parquet": LARGE})
    server.faults.truncate("*/big.parquet", at=1000)
    assert failure(FETCH, server, tmp_path) == "OSError"
    server.faults.drop("*/big.parquet", after=1000, reset=True)
    assert failure(FETCH, server, tmp_path) == "ReadError"


def test_failures_as_told(server, tmp_path):
    server.create("someone/set", {"big.parquet": LARGE})
    server.faults.fail("*/tree/*", 503, times=1)
    assert answer("api.list_repo_files('someone/set', repo_type='dataset')", server, tmp_path)
    assert [r.status for r in server.requests if "/tree/" in r.path] == [503, 200]
    server.faults.fail("*/refs", 429, headers={"Retry-After": "1"})
    assert failure("api.list_repo_refs('someone/set', repo_type='dataset')", server, tmp_path).endswith("429")


def test_a_lost_reply_leaves_the_commit(server, tmp_path):
    token = server.account("someone")
    server.create("someone/set")
    server.faults.lose_reply("*/commit/main")
    assert failure(PUT, server, tmp_path, token) == "RemoteProtocolError"
    assert server.repository("someone/set").head.files["a"].content == b"1"


def test_an_upload_that_breaks_off_is_sent_again(server, tmp_path, folder):
    token = server.account("someone")
    server.create("someone/set")
    server.faults.refuse_body("/lfs/*", after=100_000, times=1)
    client(UPLOAD.format(private=False, pull=False), server, tmp_path, token)
    puts = [request for request in server.requests if request.method == "PUT"]
    assert [request.status for request in puts] == [0, 200]
    assert server.repository("someone/set").head.files["data/train-00000-of-00001.parquet"].content == LARGE


def test_a_folder_on_disk_is_a_repository_whose_changes_are_commits(tmp_path):
    place = tmp_path / "root" / "someone" / "set"
    place.mkdir(parents=True)
    (place / "a.txt").write_text("1")
    with hub(tmp_path / "root") as server:
        first = server.repository("someone/set").head
        (place / "a.txt").write_text("12")
        (place / "b.txt").write_text("2")
        script = "api.list_repo_files('someone/set', repo_type='dataset')"
        assert answer(script, server, tmp_path) == ["a.txt", "b.txt"]
        (place / "b.txt").unlink()
        assert answer(script, server, tmp_path) == ["a.txt"]
        assert server.repository("someone/set").history[2] == first


LOAD = """
import datasets
for streaming in (False, True):
    rows = datasets.load_dataset('someone/set', split='train', streaming=streaming)
    print([row['number'] for row in rows])
"""


def test_load_dataset(server, tmp_path):
    stream = io.BytesIO()
    pq.write_table(pa.table({"number": [1, 2, 3]}), stream)
    server.create("someone/set", {"data/train-00000-of-00001.parquet": stream.getvalue()})
    done = run_python(LOAD, settings(server, tmp_path), tmp_path)
    assert done.stdout.splitlines() == ["[1, 2, 3]"] * 2, done.stderr
