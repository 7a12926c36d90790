"""``download`` and ``list`` of all three command lines, with a Hub on 127.0.0.1."""

from __future__ import annotations

import json
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from shutil import copytree

import pyarrow.parquet as pq
import pytest

from realtouch.kind import KIND as TOUCH_KIND
from realtouch.touches.loading import SHORT_NAMES
from tactile_toolkit.kind import DatasetKind, PublishedSet
from tests.hub_server import HubServer, hub
from tests.realtouch.factories import make_round, single_rows, write_set
from tests.tactile_toolkit.hub.client import run_here, settings

DIGITS = "someone/digits"
BARE = "someone/published"
SCENES = "someone/scenes"
TOUCHES = "TimSchneider42/tactile-mnist-touch-real-single-t256-64x64"


@pytest.fixture(scope="module")
def root(tmp_path_factory, digits_set, scenes_set) -> Path:
    place = tmp_path_factory.mktemp("hub")
    copytree(digits_set, place / DIGITS)
    for name, ours in ((BARE, digits_set), (SCENES, scenes_set)):
        _publish(ours, place / name)
    rounds = [make_round(index, 4, (64, 64)) for index in range(3)]
    write_set(place / TOUCHES, {"train": single_rows(rounds[1:]), "test": single_rows(rounds[:1])}, "single")
    return place


def _publish(ours: Path, there: Path) -> None:
    """Write the content of published repositories: the published columns, without manifest and reports."""
    (there / "data").mkdir(parents=True)
    for shard in sorted(ours.glob("data/*.parquet")):
        rows = pq.ParquetFile(shard).read(["id", "label", "mesh.vertices", "mesh.faces"])
        pq.write_table(rows, there / "data" / shard.name)


@pytest.fixture
def server(root) -> Iterator[HubServer]:
    with hub(root) as running:
        yield running


RUN = """
import sys
import cli.hub
cli.hub._LARGE_BYTES = {large}
from cli.{command} import main
sys.argv = [{command!r}, *{arguments!r}]
code = 0
try:
    main()
except SystemExit as leave:
    code = leave.code or 0
print('exit', code, file=sys.stderr)
"""


class Said:
    """The output of a command."""

    def __init__(self, done: subprocess.CompletedProcess[str]) -> None:
        assert done.returncode == 0, done.stderr
        *info, last = done.stderr.strip().splitlines()
        self.code = int(last.removeprefix("exit "))
        self.err, self.out = "\n".join(info), done.stdout


def call(
    server: HubServer | str, home: Path, command: str, *arguments: object, large: int = 1 << 40, **more: str
) -> Said:
    script = RUN.format(command=command, arguments=[str(part) for part in arguments], large=large)
    return Said(run_here(script, settings(server, home, **more), home))


def test_a_part_is_a_data_set_that_verifies_and_that_datasets_loads(server, tmp_path):
    out = tmp_path / "part"
    said = call(server, tmp_path, "tactile", "download", DIGITS, "--split", "test", "--out", out)
    assert said.code == 0
    assert "someone/digits at " in said.err
    assert f'next in Python: mnist3d.load("{out}", split="test")' in said.out
    assert not any("holdout" in path for path in server.fetched)
    verified = call(server, tmp_path, "tactile", "verify", out)
    assert verified.code == 0, verified.err
    assert "10 rows" in verified.out
    script = (
        f"import datasets, mnist3d\nrows = datasets.load_dataset({str(out)!r}, split='test')\n"
        f"digits = mnist3d.load({str(out)!r}, 'test')\n"
        "print([row['id'] for row in rows] == [digit.id for digit in digits], len(rows))"
    )
    loaded = run_here(script, settings("http://127.0.0.1:9", tmp_path, HF_HUB_OFFLINE="1"), tmp_path)
    assert loaded.stdout.strip() == "True 10", loaded.stderr


def test_a_copy_of_a_published_set_is_shown_and_verified(server, root, tmp_path):
    """The published repositories have no manifest, so the digests of the Hub count."""
    commit = server.repository(BARE).head.sha[:12]
    out = tmp_path / "copy"
    assert call(server, tmp_path, "tactile", "download", BARE, "--out", out).code == 0
    shown = call(server, tmp_path, "tactile", "info", out)
    assert shown.code == 0, shown.err
    assert f"downloaded from {BARE} at {commit}: no provenance recorded" in shown.out
    document = json.loads(call(server, tmp_path, "tactile", "info", out, "--json").out)
    assert [(entry["split"], entry["rows"], entry["shards"]) for entry in document["splits"]] == [
        ("holdout", 10, 1),
        ("test", 10, 1),
    ]
    assert document["splits"][0]["per_class"] == {str(digit): 1 for digit in range(10)}
    verified = call(server, tmp_path, "tactile", "verify", out)
    assert verified.code == 0, verified.err
    assert "20 rows" in verified.out
    assert f"all as in {BARE} at {commit}" in verified.out

    shard = out / "data" / "test-00000-of-00001.parquet"
    content = bytearray(shard.read_bytes())
    content[len(content) // 2] ^= 1
    shard.write_bytes(content)
    (out / "data" / "mine.parquet").write_bytes(b"x")
    (out / "data" / "holdout-00000-of-00001.parquet").unlink()
    damaged = call(server, tmp_path, "tactile", "verify", out)
    assert damaged.code == 3
    lines = damaged.err.splitlines()
    assert (
        lines[0] == "damaged: data/mine.parquet: is not listed in .download.json; "
        "next: move it to another folder"
    )
    assert lines[1] == "damaged: data/holdout-00000-of-00001.parquet: is missing"
    assert lines[2].startswith("damaged: data/test-00000-of-00001.parquet: sha256 ")
    assert f"next: download {BARE} there again; only damaged files are fetched" in lines[3]
    assert call(server, tmp_path, "tactile", "download", BARE, "--out", out).code == 0
    stray = call(server, tmp_path, "tactile", "verify", out)
    assert stray.code == 3
    assert stray.err.splitlines()[1].endswith("; next: follow the next step of each problem")
    (out / "data" / "mine.parquet").unlink()
    assert call(server, tmp_path, "tactile", "verify", out).code == 0


def test_the_line_for_python_names_the_revision_that_is_in_the_cache(server, tmp_path):
    server.repository(DIGITS).tags["v1"] = server.repository(DIGITS).head.sha
    said = call(server, tmp_path, "tactile", "download", DIGITS, "--revision", "v1", "--split", "test")
    assert f'mnist3d.load("{DIGITS}", split="test", revision="v1")' in said.out
    said = call(server, tmp_path, "tactile", "download", DIGITS, "--revision", "v1", "--out", tmp_path / "o")
    assert f'mnist3d.load("{tmp_path / "o"}", split="test")' in said.out, "a folder has no revisions"


def test_an_interrupted_download_is_called_one(server, tmp_path):
    out = tmp_path / "out"
    server.faults.fail("*/test-00000*", 503, times=99)
    assert call(server, tmp_path, "tactile", "download", DIGITS, "--out", out).code == 4
    server.faults.clear()
    again = f"download {DIGITS} there again"
    assert (
        f"the download is under way or was interrupted; next: {again}"
        in call(server, tmp_path, "tactile", "info", out).out
    )
    for command, code in (("card", 3), ("verify", 1)):
        said = call(server, tmp_path, "tactile", command, out)
        assert said.code == code, said.err
        assert again in said.err
        assert "generate" not in said.err
    small = ("--split", "test", "--per-class", "1", "--vertices", "2000", "--workers", "1", "--quiet")
    assert call(server, tmp_path, "mnist3d", "generate", *small, "--out", out, "--overwrite").code == 0
    said = call(server, tmp_path, "tactile", "download", DIGITS, "--out", out)
    assert said.code == 2, "generated data were replaced by a download"
    assert "holds a data set of another origin" in said.err


def test_the_log_of_the_client_is_silent(server, tmp_path):
    """Its lines about each retry would come from threads, without a next step."""
    server.faults.fail("*/test-00000*", 503, times=2)
    words = ("-m", "cli", "tactile", "download", DIGITS, "--out", str(tmp_path / "out"), "--yes")
    done = subprocess.run(
        [sys.executable, *words], env=settings(server, tmp_path), capture_output=True, text=True, check=False
    )
    assert (done.returncode, "HTTP Error" in done.stderr) == (0, False)


def test_waits_are_reported_while_the_download_is_planned(server, tmp_path):
    server.faults.fail("/api/datasets/*", 503, times=1)
    said = call(server, tmp_path, "tactile", "download", DIGITS, "--dry-run")
    assert said.code == 0
    assert said.err.count("the Hub answered 503") == said.err.count("; trying again in 0.01 s") == 1
    assert "HTTP Error" not in said.err


def test_json_is_one_document_and_a_repetition_fetches_nothing(server, tmp_path):
    first = json.loads(call(server, tmp_path, "tactile", "download", DIGITS, "--json").out)
    assert first["splits"] == ["test", "holdout"]
    assert first["commit"] == server.repository(DIGITS).head.sha
    assert sum(file["bytes"] for file in first["files"]) == first["bytes"]
    assert (Path(first["folder"]) / "data" / "test-00000-of-00001.parquet").is_file()
    before = len(server.fetched)
    again = call(server, tmp_path, "tactile", "download", DIGITS, "--json")
    assert json.loads(again.out)["missing_bytes"] == 0
    assert len(server.fetched) == before
    quiet = call(server, tmp_path, "tactile", "download", DIGITS, "--quiet")
    assert (quiet.out, quiet.err, quiet.code) == ("", "", 0)


def test_short_names_show_licence_and_citation(server, tmp_path):
    said = call(server, tmp_path, "tactile", "download", "real-single-64x64", "--split", "test")
    assert said.code == 0, said.err
    assert "licence: CC BY 2.0; please cite: Schneider et al., Tactile MNIST" in said.err
    assert f'realtouch.load("{TOUCHES}", split="test")' in said.out
    assert not any("train" in path for path in server.fetched)
    loaded = call("http://127.0.0.1:9", tmp_path, "tactile", "info", "real-single-64x64")
    assert loaded.code == 0, loaded.err
    assert "test" in loaded.out


def test_large_downloads_are_not_begun_unasked(server, tmp_path):
    said = call(server, tmp_path, "tactile", "download", DIGITS, large=1000)
    assert said.code == 2
    assert "would be fetched, and stdin is not a terminal; next: add --yes, or name a --split" in said.err
    assert server.fetched == ["manifest.json"]
    assert call(server, tmp_path, "tactile", "download", DIGITS, "--yes", large=1000).code == 0


@pytest.mark.parametrize(
    ("arguments", "code", "words"),
    [
        (("someone/nothing",), 4, "'someone/nothing' was not found, or is private"),
        ((DIGITS, "--split", "train"), 2, "no split 'train' in 'someone/digits': it has test, holdout"),
        ((DIGITS, "--revision", "v9"), 4, "the Hub refused reading Hub data set 'someone/digits' (404)"),
        (("mnist4d",), 2, "did you mean 'mnist3d'?"),
        ((DIGITS, "--out", "file"), 2, "a file"),
    ],
)
def test_failures_give_one_line(server, tmp_path, arguments, code, words):
    (tmp_path / "file").write_text("")
    said = call(server, tmp_path, "tactile", "download", *arguments)
    assert said.code == code
    (line,) = [line for line in said.err.splitlines() if line.startswith("error: ")]
    assert words in line
    assert "next: " in line or "choose" in line


def test_list(server, tmp_path):
    call(server, tmp_path, "tactile", "download", "real-single-64x64", "--split", "test")
    said = call(server, tmp_path, "tactile", "list", "--json")
    found = {entry["name"]: entry for entry in json.loads(said.out)}
    assert set(found) == {entry.name for kind in DatasetKind.installed() for entry in kind.published}
    here = found["real-single-64x64"]
    files = server.repository(TOUCHES).head.files
    assert here["hub_bytes"] == sum(len(blob.content) for blob in files.values())
    assert here["local_splits"] == ["test"]
    assert 0 < here["local_bytes"] < here["hub_bytes"]
    assert here["licence"] == "CC BY 2.0"
    other = found["real-seq"]
    assert (other["hub_bytes"], other["local_bytes"]) == (None, 0), "a size was invented"
    table = call(server, tmp_path, "tactile", "list")
    assert "real-single-64x64" in table.out
    assert "?: the Hub did not answer" in table.err
    alone = call("http://127.0.0.1:9", tmp_path, "tactile", "list", "--json", HF_HUB_OFFLINE="1")
    entry = next(entry for entry in json.loads(alone.out) if entry["name"] == "real-single-64x64")
    assert (entry["hub_bytes"], entry["local_bytes"]) == (None, here["local_bytes"])


def test_short_names():
    entries = [entry for kind in DatasetKind.installed() for entry in kind.published]
    assert len({entry.name for entry in entries}) == len({entry.repo_id for entry in entries}) == 9
    for entry in entries:
        assert PublishedSet.named(entry.name) == PublishedSet.named(entry.repo_id) == entry
        assert entry.citation.startswith("Schneider")
    assert PublishedSet.named("someone/digits") is None
    assert PublishedSet.named("real-single") == PublishedSet.named("real-single-320x240")
    assert {PublishedSet.named(name) for name in SHORT_NAMES} == {*TOUCH_KIND.published}
