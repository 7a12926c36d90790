"""Fields that state their valid values: valid ones are normalized, others are named."""

from __future__ import annotations

import json
from dataclasses import asdict, dataclass
from fractions import Fraction
from itertools import count

import numpy as np
import pytest

from tactile_toolkit.checked_fields import (
    check_fields,
    choice,
    integer,
    real,
    split_counts,
    switch,
    to_builtin,
    to_builtin_number,
)
from tactile_toolkit.errors import InputError


@dataclass(frozen=True, slots=True)
class _Spec:
    height_m: float = real(above=0, below=1)
    plate_mm: tuple[float, float] = real((1.0, 2.0), 0, 256, many=2)
    level: float | None = real(None, optional=True)
    rounds: int = integer(16, 1, 4096)
    limit: int | None = integer(None, 1, optional=True)
    lie: str = choice("random", ("random", "middle"))
    shift: bool = switch(True)

    def __post_init__(self) -> None:
        check_fields(self, "the example")


def test_equal_values_have_one_spelling():
    one = _Spec(0.5, (3.0, 4.0), 2.0, 7, 3, "middle", False)
    other = _Spec(
        np.float64(0.5),
        np.array([3, 4]),
        np.int8(2),
        np.int64(7),
        np.array(3),
        np.str_("middle"),
        np.bool_(False),
    )
    assert json.dumps(asdict(one)) == json.dumps(asdict(other))
    assert type(_Spec(np.float32(0.5)).height_m) is float


def test_the_ends_of_a_span_belong_to_it():
    for rounds, plate_mm, limit in ((1, (0, 256), 1), (4096, (256, 0), None), (1, (0, 0), 2**63 - 1)):
        spec = _Spec(0.5, plate_mm, rounds=rounds, limit=limit)
        assert (spec.rounds, spec.plate_mm, spec.limit) == (rounds, plate_mm, limit)


def test_a_field_without_default_is_asked_for():
    with pytest.raises(TypeError, match="height_m"):
        _Spec()


@pytest.mark.parametrize(
    ("name", "value", "message"),
    [
        ("height_m", 0, "height_m of the example is 0; expected a number above 0 and below 1"),
        ("height_m", 1.0, "expected a number above 0 and below 1"),
        ("height_m", "0.5", "height_m of the example is '0.5'"),
        ("height_m", True, "is True"),
        ("height_m", float("nan"), "is nan"),
        ("plate_mm", (1, 2, 3), "expected 2 numbers from 0 to 256"),
        ("plate_mm", (1, float("inf")), "expected 2 numbers"),
        ("plate_mm", 1.0, "expected 2 numbers"),
        ("plate_mm", count(), "an iterator of more than 1,048,576 values; next: give a list"),
        ("level", float("inf"), "expected None or a number, finite"),
        ("rounds", 0, "rounds of the example is 0; expected an integer from 1 to 4,096"),
        ("rounds", 4097, "rounds of the example is 4097"),
        ("rounds", 2.0, "is 2.0"),
        ("rounds", None, "is None"),
        ("limit", 2.5, "limit of the example is 2.5; expected an integer of at least 1"),
        ("limit", 10**45, "expected an integer of at least 1, below 2**63"),
        ("limit", 2**63, "expected an integer of at least 1, below 2**63"),
        ("lie", "left", "lie of the example is 'left'; expected one of random, middle"),
        ("lie", ["random"], "expected one of random, middle"),
        ("shift", 1, "shift of the example is 1; expected True or False"),
    ],
)
def test_invalid_values_are_named(name, value, message):
    with pytest.raises(InputError) as error:
        _Spec(**{"height_m": 0.5, name: value})
    assert message in str(error.value)


@pytest.mark.parametrize(
    ("given", "kind", "expected"),
    [
        ([1, 2], int, (1, 2)),
        (range(1, 4), int, (1, 2, 3)),
        (np.array([1.5, 2.0]), int, (1.5, 2.0)),
        (np.arange(2), float, (0.0, 1.0)),
        ((np.float32(0.5), 1), int, (0.5, 1)),
        (np.int64(3), int, 3),
        (np.array(3), int, 3),
        (3, float, 3.0),
        (Fraction(1, 2), int, 0.5),
        (True, float, True),
        (np.bool_(True), int, True),
        ("ab", int, "ab"),
        (None, int, None),
        ((("a", np.int8(1)),), int, (("a", 1),)),
    ],
)
def test_numbers_and_collections_become_plain(given, kind, expected):
    found = to_builtin(given, kind)
    assert found == expected
    assert type(found) is type(expected)
    assert json.loads(json.dumps(found)) == json.loads(json.dumps(expected))


def test_number_too_large_for_a_float_stays_for_the_checks_that_follow():
    assert to_builtin_number(10**400, float) == 10**400


def test_pairs_are_taken_as_a_mapping_too():
    for counts in ({"train": np.int64(3)}, [["train", 3]]):
        assert split_counts(counts, "sizes", ("train", "test"), 9) == (("train", 3),)
