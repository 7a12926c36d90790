"""A hostile Hub: names and digests that lead elsewhere are refused, and files outside are not changed."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from tests.hub_server import Blob
from tests.tactile_toolkit.hub.client import run_here, settings
from tests.tactile_toolkit.hub.sets import BIG, NAME, SHARD, big_parquet, fetch, script
from tests.tactile_toolkit.toy import folder_bytes

CONTENT = big_parquet(rows=9)
SHARD_NAME = "train-00000-of-00001.parquet"


@pytest.fixture
def home(tmp_path) -> Path:
    """The home folder of the client, deep enough that escapes from it are noticed."""
    home = tmp_path / "a" / "b" / "home"
    home.mkdir(parents=True)
    (tmp_path / "a" / "victim.txt").write_text("years of work")
    return home


def outside(tmp_path: Path, home: Path) -> dict[str, bytes]:
    found = folder_bytes(tmp_path)
    ours = (str(home.relative_to(tmp_path)), "root")
    return {path: content for path, content in found.items() if not path.startswith(ours)}


WILD = [
    *(f"../../victim/{SHARD_NAME}", f"data/../../../{SHARD_NAME}", f"/tmp/evil/{SHARD_NAME}"),
    *(f"C:\\{SHARD_NAME}", f"data\\..\\..\\{SHARD_NAME}", f".git/{SHARD_NAME}", f"con/{SHARD_NAME}"),
    *(f"data/x\0/{SHARD_NAME}", f"data/\u202e/{SHARD_NAME}", f"data/{'x' * 200}/{SHARD_NAME}"),
]


@pytest.mark.parametrize("name", WILD)
def test_a_shard_with_a_wild_name_is_not_fetched(server, tmp_path, home, name):
    server.create(BIG, {name: CONTENT, "README.md": b"#"})
    before = outside(tmp_path, home)
    for text in (script(BIG), script(BIG, out=home / "out")):
        code, kind, words = fetch(server, home, text)
        if name.startswith(".git/"):  # a hidden folder is ignored
            assert (code, kind) == (2, "InputError")
            assert "no Parquet files" in words
        else:
            assert (code, kind) == (3, "IntegrityError")
            assert f"Hub data set {BIG!r} names the file {ascii(name)[:40]}" in words
        assert words.isprintable()
    assert outside(tmp_path, home) == before
    assert not (home / "out").exists()
    assert server.fetched == []


@pytest.mark.parametrize(
    "name", ["reports/../../../victim.txt", "previews/.hidden.png", "images/train/\\x.png"]
)
def test_files_beside_shards_have_plain_names_too(server, tmp_path, home, name):
    files = {path: blob.content for path, blob in server.repository(NAME).head.files.items()}
    server.create("someone/wild", {**files, name: b"evil"})
    before = outside(tmp_path, home)
    code, kind, words = fetch(server, home, script("someone/wild", out=home / "deep" / "out"))
    assert (code, kind) == (3, "IntegrityError")
    assert f"names the file {name!a}" in words
    assert outside(tmp_path, home) == before


def test_two_files_that_are_one_elsewhere_are_refused(server, home):
    other = "Data/train-00000-of-00001.parquet"
    server.create(BIG, {SHARD: CONTENT, other: CONTENT})
    assert "is the same file as" in fetch(server, home, script(BIG, out=home / "out"))[2]


def test_a_manifest_of_the_hub_is_read_as_warily(server, tmp_path, home):
    files = {path: blob.content for path, blob in server.repository(NAME).head.files.items()}
    values = json.loads(files["manifest.json"])
    before = outside(tmp_path, home)
    for wild in ({"../../../evil": "0" * 64}, {"reports/x.txt": "../../../evil"}):
        text = json.dumps({**values, "files": {**values["files"], **wild}}).encode()
        server.create("someone/wild", {**files, "manifest.json": text, "reports/x.txt": b"evil"})
        code, kind, words = fetch(server, home, script("someone/wild", out=home / "deep" / "out"))
        assert (code, kind) == (3, "IntegrityError")
        assert "someone/wild/manifest.json" in words
    assert outside(tmp_path, home) == before
    assert not (home / "deep").exists()


@pytest.mark.parametrize("part", ["oid", "sha256"])
def test_digests_of_the_hub_are_digests(server, tmp_path, home, monkeypatch, part):
    before = outside(tmp_path, home)
    monkeypatch.setattr(Blob, part, property(lambda _: "../../../../../../evil"))
    code, kind, words = fetch(server, home, script(BIG, out=home / "out"))
    assert (code, kind) == (4, "HubError")
    assert "does not answer as a Hub does while reading Hub data set 'someone/big'" in words
    assert outside(tmp_path, home) == before


HEAD = """
from tactile_toolkit.errors import ToolkitError
from tactile_toolkit.hub.repository import open_repository
from tests.hub_server import Blob
repository = open_repository({name!r})
repository.files()
Blob.{part} = property(lambda _: "../../../../../../evil")
try:
    print(repository.local_paths(["README.md"]))
except ToolkitError as error:
    print(error.exit_code, type(error).__name__, error)
"""


def test_the_client_does_not_use_file_names_of_the_hub(server, tmp_path, home, monkeypatch):
    """The cache of the client takes its file names from the headers of replies."""
    before = outside(tmp_path, home)
    monkeypatch.setattr(Blob, "oid", Blob.oid)  # restores the changes of the script
    text = HEAD.format(name=BIG, part="oid")
    done = run_here(text, settings(server, home), home)
    assert "4 HubError the Hub calls a file " in done.stdout
    assert "evil" in done.stdout
    assert outside(tmp_path, home) == before


REVISION = """
from tactile_toolkit.hub.repository import commit_of, remember_commit
remember_commit("someone/big", {revision!r}, "0" * 40)
print(commit_of("someone/big", {revision!r}))
"""


@pytest.mark.parametrize("revision", ["../../../../evil", "..", "/tmp/evil-revision", "a\0b"])
def test_revisions_are_remembered_inside_the_cache_only(server, tmp_path, home, revision):
    before = outside(tmp_path, home)
    done = run_here(REVISION.format(revision=revision), settings(server, home), home)
    assert done.stdout.strip() == "None"
    assert outside(tmp_path, home) == before
    assert not Path("/tmp/evil-revision").exists()
