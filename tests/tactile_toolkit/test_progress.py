"""Progress on stderr: without a terminal, a line every few seconds, and no line for short work."""

from __future__ import annotations

import math
from queue import Queue
from unittest.mock import Mock

import pytest

from tactile_toolkit.run.this_process import shown_progress


@pytest.mark.parametrize(
    ("quiet_s", "expected"),
    [
        (0.0, ["making: 2 of 9", "making: 5 of 9", "making: 9 of 9"]),
        (6.5, ["making: 3 of 9", "making: 9 of 9"]),
        (60.0, []),
    ],
)
def test_lines_come_every_few_seconds_and_at_the_end(quiet_s, expected, capsys, monkeypatch):
    now_s = [0.0]
    monkeypatch.setattr("tactile_toolkit.run.this_process.time.monotonic", lambda: now_s[0])
    with shown_progress("making", "digits", quiet_s) as update:
        for done, at_s in ((0, 0), (1, 3), (2, 6), (3, 8), (4, 10), (5, 12), (9, 13)):
            now_s[0] = at_s
            update(done, 9)
    assert [line.split(",")[0] for line in capsys.readouterr().err.splitlines()] == expected


@pytest.mark.parametrize(
    ("is_terminal", "quiet_s", "silent_s"),
    [(False, 0.0, 0.01), (False, 60.0, 0.01), (True, 0.0, 3600.0)],
    ids=["a line a minute", "also where progress is not shown before some seconds", "at a terminal at once"],
)
def test_a_line_says_that_work_goes_on_while_no_item_is_finished(is_terminal, quiet_s, silent_s, monkeypatch):
    monkeypatch.setattr("tactile_toolkit.run.this_process._SILENT_S", silent_s)
    written = Queue[str]()
    monkeypatch.setattr("sys.stderr", Mock(isatty=lambda: is_terminal, write=written.put))
    with shown_progress("calibrating", "steps", quiet_s):
        assert written.get(timeout=60).lstrip("\r").startswith("calibrating: at work for ")
    with shown_progress("nothing", "steps", math.inf):
        assert "nothing" not in "".join(written.queue)
