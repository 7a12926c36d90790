"""Arguments of `realtouch.load`: names, addresses and files, on this machine and on the Hub."""

from __future__ import annotations

import shutil
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest

import realtouch
from realtouch.touches.loading import SHORT_NAMES
from tactile_toolkit.errors import HubError, InputError
from tactile_toolkit.places import open_place
from tests.hub_server import HubServer, hub
from tests.tactile_toolkit.hub.client import run_here, settings


@pytest.mark.parametrize("name", [None, 123, b"real-seq", [None], [b"a.parquet"]])
def test_invalid_names_are_refused(name: Any) -> None:
    with pytest.raises(InputError, match="is not a name of a data set; expected a short name such as"):
        realtouch.load(name)


@pytest.mark.parametrize("name", sorted(SHORT_NAMES))
def test_local_data_of_a_short_name_comes_first(name, single_folder, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("HF_HUB_OFFLINE", "1")
    monkeypatch.setattr("huggingface_hub.constants.HF_HUB_OFFLINE", True)
    for _ in range(2):
        with pytest.raises(HubError, match="TimSchneider42/"):
            open_place(name)
        Path(name).mkdir(exist_ok=True)  # a folder without data is not a data set
    shutil.copytree(single_folder / "data", Path(name) / "data")
    assert open_place(name).folder is not None
    assert len(realtouch.load(name, "train")) == 3
    assert realtouch.verify(name).ok


def contents(folder: Path) -> dict[str, bytes]:
    return {f"data/{file.name}": file.read_bytes() for file in (folder / "data").glob("*.parquet")}


@pytest.fixture(scope="module")
def server(single_folder: Path, tmp_path_factory: pytest.TempPathFactory) -> Iterator[HubServer]:
    with hub(tmp_path_factory.mktemp("hub")) as running:
        running.create("someone/single", contents(single_folder))
        test = contents(single_folder)["data/test-00000-of-00001.parquet"]
        running.create("someone/converted", {"default/test/0000.parquet": test})
        yield running


LOAD = """
import realtouch
from tactile_toolkit.errors import ToolkitError
try:
    print(*(record.id for record in realtouch.load({arguments})))
except ToolkitError as error:
    print(type(error).__name__, error)
"""
SINGLE = "hf://datasets/someone/single"
TRAIN = "data/train-00000-of-00002.parquet"
REST = "data/train-00001-of-00002.parquet"


@pytest.mark.parametrize(
    ("arguments", "rows"),
    [
        (f"'{SINGLE}', 'train'", [0, 1, 2]),
        ("'someone/single@main', 'train'", [0, 1, 2]),
        (f"'{SINGLE}@main', 'test'", [3]),
        (f"'{SINGLE}@main/data', 'test'", [3]),
        (f"'{SINGLE}/{TRAIN}'", [0, 1]),
        (f"'{SINGLE}@main/{REST}', 'train'", [2]),
        (f"['{SINGLE}/{REST}', '{SINGLE}/{TRAIN}']", [2, 0, 1]),
        (f"['{SINGLE}/{REST}'], revision='main', streaming=True", [2]),
        (f"'{SINGLE}/{TRAIN}', streaming=True", [0, 1]),
        ("'someone/converted', 'test'", [3]),
        ("'someone/converted'", [3]),
        ("'someone/converted', streaming=True", [3]),
    ],
)
def test_files_and_revisions_of_the_hub(arguments, rows, server, single_folder, tmp_path):
    sets = [*realtouch.load(single_folder, "train"), *realtouch.load(single_folder, "test")]
    done = run_here(LOAD.format(arguments=arguments), settings(server, tmp_path), tmp_path)
    assert done.stdout.split() == [sets[row].id for row in rows], done.stdout


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (f"'{SINGLE}/data/nothing.parquet'", "HubError Hub data set 'someone/single' has no file 'data/noth"),
        (
            f"['{SINGLE}/data/nothing.parquet'], streaming=True",
            "HubError Hub data set 'someone/single' has no",
        ),
        (f"['{SINGLE}']", f"InputError '{SINGLE}' is not a file"),
        ("'someone/single@v9'", "HubError the Hub refused reading Hub data set 'someone/single' (404)"),
        (
            "'someone/single@main', revision='v9'",
            "InputError 'someone/single@main' names the revision 'main'",
        ),
        ("'someone/single'", "InputError 'someone/single' has the splits test, train; expected one of them"),
        ("'someone/converted', 'train'", "InputError no split 'train' in 'someone/converted': it has test"),
    ],
)
def test_names_missing_on_the_hub_are_named(arguments, words, server, tmp_path):
    done = run_here(LOAD.format(arguments=arguments), settings(server, tmp_path), tmp_path)
    assert done.stdout.startswith(words)


MOVES: list[Callable[[], None]] = []
STREAM = """
import realtouch
from tests.realtouch import test_names
rounds = iter(realtouch.load('someone/moving', 'train', streaming=True))
print(next(rounds).id)
test_names.MOVES.pop()()
print(*(record.id for record in rounds))
"""


def test_a_stream_is_of_one_commit(server: HubServer, single_folder: Path, tmp_path: Path) -> None:
    repository = server.create("someone/moving", contents(single_folder))
    other = (single_folder / "data" / "test-00000-of-00001.parquet").read_bytes()
    MOVES.append(lambda: repository.commit({REST: repository.blob(REST, other)}, "another second shard"))
    done = run_here(STREAM, settings(server, tmp_path), tmp_path)
    assert not MOVES, "nothing was committed meanwhile"
    assert done.stdout.split() == [record.id for record in realtouch.load(single_folder, "train")]
    cached = tmp_path / "hf" / "hub" / "datasets--someone--moving"
    assert [place.name for place in cached.iterdir()] == ["refs"], "files were fetched"
