from __future__ import annotations

import pytest

from tactile_toolkit.wording import counted


@pytest.mark.parametrize(
    ("count", "things", "words"),
    [
        (1, "digits", "1 digit"),
        (1, "touches", "1 touch"),
        (1, "boxes", "1 box"),
        (1, "classes", "1 class"),
        (1, "other objects", "1 other object"),
        (0, "rounds", "0 rounds"),
        (2_000, "scenes", "2,000 scenes"),
    ],
)
def test_one_thing_is_one(count, things, words):
    assert counted(count, things) == words
