"""``upload`` against a real server, and the way back through `datasets` and the toolkit."""

from __future__ import annotations

import json
import logging
import os
import re
import shutil
import subprocess
from collections.abc import Iterator
from pathlib import Path

import pytest

from tests.command_line import call, program
from tests.hub_server import HubServer, hub
from tests.processes import PATIENCE_S
from tests.tactile_toolkit.exchange.upload_client import logged_in
from tests.tactile_toolkit.hub.client import run_here, run_python, settings

pty = pytest.importorskip("pty")

NAME = "someone/stars"

pytestmark = pytest.mark.filterwarnings(
    "ignore:Use 'content=<...>':DeprecationWarning"  # of the client's own making, in every PUT
)


def run(command: str, *arguments: object, environment: dict[str, str]) -> subprocess.CompletedProcess[str]:
    """Run a command line in a process of its own."""
    environment = {**environment, "PYTHONPATH": str(Path.cwd())}
    words = program(command, *arguments)
    return subprocess.run(
        words, env=environment, capture_output=True, text=True, check=False, timeout=PATIENCE_S
    )


@pytest.fixture
def folder(scenes_set, tmp_path) -> Path:
    """Two splits of scenes."""
    return Path(shutil.copytree(scenes_set, tmp_path / "stars"))


@pytest.fixture
def server(monkeypatch) -> Iterator[HubServer]:
    with hub() as running, logged_in(running, running.account("someone"), monkeypatch):
        yield running


THERE_AND_BACK = """
import datasets, hashlib, mnist3d
datasets.disable_progress_bars()
def digest(columns):
    return hashlib.sha256(b''.join(
        bytes(memoryview(__import__('numpy').asarray(value, dtype).tobytes())) for value, dtype in columns
    )).hexdigest()
def of_rows(rows):
    return digest([
        pair for row in rows
        for pair in ((row['mesh.vertices'], 'float32'), (row['mesh.faces'], 'int32'))
    ])
held = datasets.load_dataset('{name}', split='test')
print(len(held), of_rows(held))
streamed = list(datasets.load_dataset('{name}', split='test', streaming=True))
print(len(streamed), of_rows(streamed))
ours = list(mnist3d.load('{name}', split='test'))
print(len(ours), digest([
    pair for record in ours for pair in ((record.vertices_m, 'float32'), (record.faces, 'int32'))
]))
here = list(mnist3d.load({folder!r}, split='test'))
print(len(here), digest([
    pair for record in here for pair in ((record.vertices_m, 'float32'), (record.faces, 'int32'))
]))
"""


def there_and_back(server: HubServer, home: Path, folder: Path, name: str, more: str) -> list[str]:
    """Load a split from the Hub in three ways, and from the folder; return what each printed, and `more`."""
    script = THERE_AND_BACK.format(name=name, folder=str(folder)) + more
    environment = settings(server, home, next(iter(server.accounts)), PYTHONPATH=str(Path.cwd()))
    done = run_python(script, environment, home)
    assert done.returncode == 0, done.stderr
    return done.stdout.splitlines()


@pytest.mark.thorough
def test_the_whole_way(digits_set, tmp_path):
    """Upload and load: real processes, nothing but HF_ENDPOINT set; the same meshes, byte for byte."""
    with hub() as server:
        token = server.account("someone")
        environment = settings(server, tmp_path, token)
        sent = run("tactile", "upload", digits_set, "someone/digits", "--yes", environment=environment)
        assert sent.returncode == 0, sent.stderr
        assert token not in sent.stdout + sent.stderr
        lines = [line.strip() for line in sent.stdout.splitlines()]
        assert f"{server.endpoint}/datasets/someone/digits" in lines
        assert lines[-2:] == ["import mnist3d", 'data = mnist3d.load("someone/digits", split="test")']
        card = server.repository("someone/digits").head.files["README.md"].content.decode()
        with_datasets, with_toolkit, *_ = re.findall(r"```python\n(.*?)```", card, flags=re.DOTALL)
        code = with_datasets + with_toolkit
        *ways, first, second = there_and_back(server, tmp_path, digits_set, "someone/digits", code)
    assert len(ways) == 4
    assert len(set(ways)) == 1
    assert ways[0].startswith("10 ")
    assert first
    assert second


def test_upload_lists_its_files_and_sends_none_twice(server, folder, capsys):
    (folder / "notes.txt").write_text("mine")
    assert call("tactile", "upload", folder, NAME, "--yes", "--tag", "v1") == 0
    printed = capsys.readouterr()
    assert "public repository to create: someone/stars" in printed.out
    for path in ("README.md", "data/train-00000-of-00001.parquet", "manifest.json", "previews/scenes.png"):
        assert re.search(rf"{path} .*[kM]?B +new", printed.out)
    assert re.search(r"5 of 5 files to send, [\d.]+ kB of [\d.]+ kB, 0 to remove", printed.out)
    assert "sent 5 files, removed 0; all 5 compared by checksum" in printed.out
    assert "tag set: v1" in printed.out
    assert "left out, not part of the data set: notes.txt" in printed.err
    assert call("tactile", "upload", folder, NAME, "--yes") == 0
    assert "someone/stars holds all files already, compared by checksum; nothing was sent" in (
        capsys.readouterr().out
    )
    assert call("tactile", "upload", folder, NAME, "--dry-run") == 0
    assert "someone/stars holds all files already, compared by checksum; nothing was sent" in (
        capsys.readouterr().out
    )
    assert call("tactile", "upload", folder, NAME, "--branch", "next") == 2, "a branch is asked for too"
    assert "branch to create at the head of main: next" in capsys.readouterr().out


def test_dry_run_sends_nothing_and_needs_no_login(server, folder, capsys, monkeypatch):
    monkeypatch.delenv("HF_TOKEN")
    logging.getLogger("huggingface_hub").setLevel(logging.INFO)
    assert call("tactile", "upload", folder, NAME, "--dry-run", "--private", "--branch", "next") == 0
    assert not logging.getLogger("huggingface_hub").isEnabledFor(logging.WARNING), "the client is quiet, too"
    printed = capsys.readouterr().out
    assert "private repository to create: someone/stars (next)" in printed
    assert "5 of 5 files to send" in printed
    assert printed.endswith("nothing was sent\n")
    assert {request.method for request in server.requests} == {"GET"}
    server.create(NAME, {"old.txt": b"x"})
    assert call("tactile", "upload", folder, NAME, "--dry-run", "--delete", "--json") == 0
    told = json.loads(capsys.readouterr().out)
    assert (told["dry_run"], told["to_remove"], told["sent"], told["commit"]) == (True, ["old.txt"], [], None)
    assert len(told["to_send"]) == told["files"] == 5
    assert {request.method for request in server.requests} == {"GET"}


@pytest.mark.thorough
@pytest.mark.parametrize(("answer", "code"), [("y", 0), ("n", 2)])
def test_on_a_terminal_it_asks(server, folder, tmp_path, answer, code):
    environment = settings(server, tmp_path, next(iter(server.accounts)), PYTHONPATH=str(Path.cwd()))
    ours, theirs = pty.openpty()
    process = subprocess.Popen(
        program("tactile", "upload", folder, NAME),
        env=environment,
        stdin=theirs,
        stderr=theirs,
        stdout=subprocess.DEVNULL,
    )
    os.close(theirs)
    os.write(ours, f"{answer}\n".encode())
    said = b""
    while piece := _read(ours):
        said += piece
    os.close(ours)
    assert process.wait(60) == code, said.decode()
    assert f"Send this to {server.endpoint}/datasets/{NAME}?".encode() in said
    assert (NAME in [name for _, name in server.repositories]) == (code == 0)


def _read(terminal: int) -> bytes:
    """Read from a terminal; nothing when the other side has closed it."""
    try:
        return os.read(terminal, 4096)
    except OSError:
        return b""


@pytest.mark.parametrize(
    ("account", "name", "words"),
    [
        (None, NAME, "needs a valid token; next: log in with `hf auth login`"),
        (("someone", "read"), NAME, "Your token does not have write access"),
        (("stranger", "write"), NAME, "You don't have the rights to write under the namespace 'someone'"),
        (("someone", "write"), "a/b/c", "'a/b/c' is not a name of a repository; next: give USER/NAME"),
    ],
)
def test_refusals_give_one_line(server, folder, capsys, monkeypatch, account, name, words):
    token = server.account(*account) if account else None
    monkeypatch.setenv("HF_TOKEN", token or "")
    code = call("tactile", "upload", folder, name, "--yes")
    printed = capsys.readouterr()
    assert code == (2 if "not a name" in words else 4)
    (line,) = [line for line in printed.err.splitlines() if line.startswith("error: ")]
    assert words in line
    assert not token or token not in printed.out + printed.err
    assert not any(request.method == "PUT" for request in server.requests)


def test_a_missing_network_is_named(folder, tmp_path):
    environment = settings("http://127.0.0.1:9", tmp_path, "hf_abcdefgh")
    words = ("tactile", "upload", str(folder), NAME, "--yes")
    script = f"from tests.command_line import call\nprint(call(*{words!r}))"
    done = run_here(script, environment, tmp_path)
    assert done.stdout.splitlines()[-1] == "4"
    assert "no connection to the Hub at http://127.0.0.1:9" in done.stderr
    assert "hf_abcdefgh" not in done.stdout + done.stderr


def test_a_damaged_folder_is_not_sent(server, folder, tmp_path, capsys):
    copy = Path(shutil.copytree(folder, tmp_path / "copy"))
    (copy / "data" / "test-00000-of-00001.parquet").unlink()
    assert call("tactile", "upload", copy, NAME, "--yes") == 3
    assert "data/test-00000-of-00001.parquet: is missing" in capsys.readouterr().err
    assert server.requests == []
