"""Small sets in the published schema, made once for all tests."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.realtouch import factories
from tests.realtouch.factories import Layout, RoundTruth
from tests.realtouch.images_of_others import picture

SIZE, FRAMES = (96, 72), (26, 40)
TOUCHES = 5


@pytest.fixture(scope="session")
def truth() -> list[RoundTruth]:
    """Three rounds of five touches in small pictures; touch 2 of each round misses the digit."""
    return [factories.make_round(index, TOUCHES, SIZE, FRAMES) for index in range(3)]


@pytest.fixture(scope="session")
def held_out() -> list[RoundTruth]:
    """Round of the split test."""
    return [factories.make_round(3, TOUCHES, SIZE, FRAMES)]


@pytest.fixture(scope="session")
def seq_rows(truth: list[RoundTruth]) -> list[dict]:
    return factories.seq_rows(truth)


@pytest.fixture(scope="session")
def single_rows(truth: list[RoundTruth]) -> list[dict]:
    return factories.single_rows(truth)


@pytest.fixture(scope="session")
def seq_folder(
    seq_rows: list[dict], held_out: list[RoundTruth], tmp_path_factory: pytest.TempPathFactory
) -> Path:
    """Train and test split of clips."""
    folder = tmp_path_factory.mktemp("seq")
    return factories.write_set(folder, {"train": seq_rows, "test": factories.seq_rows(held_out)}, "seq")


@pytest.fixture(scope="session")
def single_folder(
    single_rows: list[dict], held_out: list[RoundTruth], tmp_path_factory: pytest.TempPathFactory
) -> Path:
    """Train and test split of images, train in two shards of row groups of one row."""
    folder = tmp_path_factory.mktemp("single")
    layout = Layout(shards=2, group_rows=1)
    factories.write_set(folder, {"train": single_rows}, "single", layout)
    return factories.write_set(folder, {"test": factories.single_rows(held_out)}, "single")


@pytest.fixture(params=["single", "seq"])
def source(request: pytest.FixtureRequest) -> Path:
    return request.getfixturevalue(f"{request.param}_folder")


@pytest.fixture
def small_shards(monkeypatch: pytest.MonkeyPatch) -> None:
    """Write a file for each round, so that there are several."""
    monkeypatch.setattr("realtouch.convert.conversion._MAX_ROWS_PER_SHARD", 1)
    monkeypatch.setattr("realtouch.formats.lerobot_export._FILE_BYTES", 1 << 10)


@pytest.fixture
def home(tmp_path: Path) -> Path:
    home = tmp_path / "home"
    (home / "pictures").mkdir(parents=True)
    for number in range(4):
        (home / "pictures" / f"{number}.jpg").write_bytes(picture(40 * number))
    return home
