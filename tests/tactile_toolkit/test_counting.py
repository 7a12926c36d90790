from __future__ import annotations

import pytest

from tactile_toolkit.wording import class_name, with_count


@pytest.mark.parametrize(
    ("count", "things", "words"),
    [
        (1, "digits", "1 digit"),
        (1, "touches", "1 touch"),
        (1, "boxes", "1 box"),
        (1, "classes", "1 class"),
        (1, "other objects", "1 other object"),
        (1, "vertices", "1 vertex"),
        (1, "such entries", "1 such entry"),
        (1, "bodies", "1 body"),
        (0, "rounds", "0 rounds"),
        (2_000, "scenes", "2,000 scenes"),
    ],
)
def test_one_thing_is_one(count, things, words):
    assert with_count(count, things) == words


def test_a_class_without_a_name_is_its_number():
    assert [class_name(("zero", "one"), label) for label in (0, 1, 2, -1)] == ["zero", "one", "2", "-1"]
