"""The paper's numbers, measured on a small made-up set."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest

import realtouch
from realtouch.touches.loading import paper_numbers
from tests.realtouch.factories import make_round, single_rows, write_set


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Give six rounds of 256 touches; the gel is replaced after the fourth, which was recorded third."""
    alike = make_round(0, 256, (64, 64), (2, 3))
    few = [make_round(index, 1) for index in range(6)]
    rounds = [replace(round_, touches=alike.touches, pos_in_cell_m=alike.pos_in_cell_m) for round_ in few]
    rounds = [replace(each, gel_id=17 if index < 4 else 23) for index, each in enumerate(rounds)]
    shuffled = [rounds[index] for index in (5, 0, 3, 1)]
    folder = tmp_path_factory.mktemp("reproduce")
    write_set(folder, {"train": single_rows(shuffled)}, "single")
    return write_set(folder, {"test": single_rows([rounds[4], rounds[2]])}, "single")


def found(folder: Path, splits: tuple[str, ...] = ("train", "test")) -> dict[str, tuple[str, bool]]:
    numbers = paper_numbers({split: realtouch.load(str(folder), split) for split in splits})
    return {each.what: (each.found, each.agrees) for each in numbers}


def test_each_number_is_that_of_the_data(folder):
    numbers = found(folder)
    assert numbers["rounds"] == ("6", False)
    assert numbers["touches"] == ("1,536", False)
    assert numbers["touches of a round"] == ("256", True)
    assert numbers["classes in test"] == ("2 of 1 rounds", False)
    assert numbers["objects in two splits"] == ("none", True)
    assert numbers["gel replaced after"] == ("1,024 of 1,536", False)
    assert numbers["picture"] == ("64 x 64 pixels", True)
    what, agrees = numbers["intended positions"]
    assert agrees
    assert what.startswith("at most 49.") or what.startswith("at most 50.0")


def test_a_paper_sized_gel_agrees(folder, monkeypatch):
    monkeypatch.setattr("realtouch.touches.loading._TOUCHES_OF_A_GEL", 1024)
    assert found(folder)["gel replaced after"] == ("1,024 of 1,536", True)


def test_an_object_in_two_splits_is_found(folder):
    train = realtouch.load(str(folder), "train")
    numbers = {each.what: each for each in paper_numbers({"train": train, "test": train[:1]})}
    assert not numbers["objects in two splits"].agrees
