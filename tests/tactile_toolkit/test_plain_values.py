from __future__ import annotations

import json
from fractions import Fraction

import numpy as np
import pytest

from tactile_toolkit.checked_fields import to_builtin, to_builtin_number, to_builtin_pairs


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
    assert to_builtin_pairs({"train": np.int64(3)}) == to_builtin_pairs([["train", 3]]) == (("train", 3),)
