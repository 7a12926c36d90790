"""Choice of the digits of an export, by class, id and number."""

from __future__ import annotations

from pathlib import Path

import pytest

import mnist3d
from tactile_toolkit.catalog import RowFilter
from tactile_toolkit.errors import InputError
from tactile_toolkit.printing.file_export import PrintObject, objects_of


@pytest.fixture
def digits(digits_set: Path) -> mnist3d.DigitDataset:
    return mnist3d.load(digits_set, "test")


def chosen(digits: mnist3d.DigitDataset, **choice: object) -> list[PrintObject]:
    return objects_of(RowFilter(**choice).choose([("test", digits)]))  # type: ignore[arg-type]


def test_names_tell_split_class_and_id(digits: mnist3d.DigitDataset) -> None:
    names = [item.name for item in chosen(digits)]
    assert names == [f"test-{r.label}-{r.id:05d}" for r in digits]
    assert len(set(names)) == 10


def test_choosing_by_class_id_and_number(digits: mnist3d.DigitDataset) -> None:
    assert {item.label for item in chosen(digits, labels=["3", "7"])} == {"3", "7"}
    some = digits.ids[[4, 8]].tolist()
    assert sorted(item.id for item in chosen(digits, ids=some)) == sorted(some)
    assert [item.id for item in chosen(digits, limit=3)] == digits.ids[:3].tolist()
    label = str(digits.labels[4])
    assert [item.id for item in chosen(digits, ids=some[:1], labels=[label])] == some[:1]


def test_missing_digits_are_named(digits: mnist3d.DigitDataset) -> None:
    some = digits.ids[[4, 8]]
    items = chosen(digits, ids=[(int(some.min()), int(some.max())), (0, 10**19)])
    assert {item.id for item in items} == set(digits.ids.tolist())
    between = chosen(digits, ids=[(int(some.min()), int(some.max()))])
    assert {item.id for item in between} == {
        number for number in digits.ids.tolist() if some.min() <= number <= some.max()
    }
    with pytest.raises(InputError, match=r"an id from 99998 to 100000000"):
        chosen(digits, ids=[(99998, 10**8)])
    with pytest.raises(InputError, match="no object with id 99999 in what was chosen"):
        chosen(digits, ids=[99999, int(digits.ids[0]), 99998])
    with pytest.raises(InputError, match=r"no class 'x'.*expected one of 0, 1"):
        chosen(digits, labels=["x"])
    label = str((int(digits.labels[0]) + 1) % 10)
    with pytest.raises(InputError, match="no object is chosen"):
        chosen(digits, ids=[int(digits.ids[0])], labels=[label])
    with pytest.raises(InputError, match="two objects would be called"):
        objects_of(RowFilter.ALL.choose([("test", digits), ("test", digits)]))
