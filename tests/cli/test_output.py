"""Output of commands: tables on narrow terminals, readable rates and sizes."""

from __future__ import annotations

import os
import re
import struct
import subprocess
import sys

import pytest

from cli.contents import _flat_lines
from cli.output import Sink
from tactile_toolkit.wording import BYTES, bytes_text, did_you_mean, duration_text, rate_text

fcntl = pytest.importorskip("fcntl")
pty = pytest.importorskip("pty")
termios = pytest.importorskip("termios")

HEADER = ("mesh", "solid", "volume mm³", "size mm", "bodies", "thinnest wall mm", "findings")
ROWS = [
    ("test 12623", "yes", "4,595", "36.6 x 60.8 x 8.1", 1, "6.88", "none"),
    ("test 9082", "NO", "6,299", "39.0 x 60.2 x 8.1", 12, "6.68", "two of 12 bodies overlap by 0.3 mm³"),
]
TITLE = "checked [b]digits[/b]"
PRINTED = f"from cli.output import Sink\nSink().table({HEADER!r}, {ROWS!r}, {TITLE!r})"


def in_terminal(columns: int, code: str) -> str:
    """Run Python code in a terminal of some columns, and return its screen."""
    leader, follower = pty.openpty()
    fcntl.ioctl(follower, termios.TIOCSWINSZ, struct.pack("HHHH", 40, columns, 0, 0))
    settings = {name: value for name, value in os.environ.items() if name not in ("COLUMNS", "LINES")}
    with subprocess.Popen(
        [sys.executable, "-c", code],
        stdin=follower,
        stdout=follower,
        stderr=follower,
        env={**settings, "NO_COLOR": "1"},
    ) as process:
        os.close(follower)
        text = b""
        while True:
            try:
                part = os.read(leader, 65536)
            except OSError:  # Linux reports this if the other side is not open
                break
            if not part:
                break
            text += part
    os.close(leader)
    assert process.returncode == 0, text.decode()
    return re.sub(r"\x1b\[[0-9;]*m", "", text.decode()).replace("\r\n", "\n")


@pytest.mark.parametrize("columns", [40, 60, 80, 100, 200])
def test_no_cell_is_cut_in_any_terminal(columns, capsys, monkeypatch):
    monkeypatch.setenv("COLUMNS", str(columns))
    monkeypatch.setattr(sys.stdout, "isatty", lambda: True)
    Sink().table(HEADER, ROWS, TITLE)
    text = capsys.readouterr().out
    if columns == 60:
        assert in_terminal(columns, PRINTED) == text, "the width is that of the terminal"
    text = re.sub(r"\x1b\[[0-9;]*m", "", text)
    assert TITLE in text
    assert "…" not in text
    assert max(map(len, text.splitlines())) <= columns
    whole = " ".join(text.split())
    for row in ROWS:
        for cell in map(str, row[:-1]):
            assert cell in text
    for word in (*HEADER[0].split(), *ROWS[1][-1].split(), "thinnest"):
        assert word in whole.split()
    # One below the other if columns have no room.
    assert (columns < 100) == ("\n  findings" in text)
    assert (columns < 100) == (f"\n{HEADER[0]} " in text and f"\n  {HEADER[1]}" in text)


def test_a_long_cell_continues_below_itself(capsys, monkeypatch):
    monkeypatch.setenv("COLUMNS", "26")
    monkeypatch.setattr(sys.stdout, "isatty", lambda: True)
    Sink().table(("mesh", "findings"), [("test 1", "two of 12 bodies overlap")])
    assert capsys.readouterr().out.splitlines() == [
        "mesh       test 1",
        "  findings two of 12",
        "           bodies overlap",
    ]


def test_truths_are_words_in_a_table(capsys):
    Sink().table(("mesh", "solid"), [("a", True), ("b", False)])
    assert [line.split() for line in capsys.readouterr().out.splitlines()[2:]] == [["a", "yes"], ["b", "-"]]


def test_a_terminal_shows_a_bar_that_fits_it(capsys, monkeypatch):
    monkeypatch.setenv("COLUMNS", "50")
    monkeypatch.setattr(sys.stderr, "isatty", lambda: True)
    monkeypatch.setattr("tactile_toolkit.run.this_process._BAR_INTERVAL_S", 0.0)
    with Sink().progress("drawing", "digits") as update:
        for done in (0, 1, 4):
            update(done, 4)
    begun, first, last = capsys.readouterr().err.split("\r")
    assert begun == ""
    assert 4 * first.count("━") == last.count("━") > 4
    assert " drawing: 1 of 4, " in first
    assert last.endswith("\x1b[K\n")
    assert max(len(line.rstrip("\n").removesuffix("\x1b[K")) for line in (first, last)) < 50


def test_a_table_in_a_pipe_keeps_its_columns(capsys):
    Sink().table(HEADER, ROWS)
    lines = [line for line in capsys.readouterr().out.splitlines() if "test" in line]
    assert len(lines) == len(ROWS)


@pytest.mark.parametrize(
    ("done", "elapsed_s", "unit", "text"),
    [
        (1, 40.0, "pictures", "1.5 pictures/min"),
        (1, 7200.0, "pictures", "0.5 pictures/h"),
        (30, 2.0, "digits", "15 digits/s"),
        (30, 8.0, "digits", "3.8 digits/s"),
        (5_000_000, 2.0, "rows", "2,500,000 rows/s"),
        (897_737_000, 10.0, BYTES, "89.8 MB/s"),
    ],
)
def test_rates_are_numbers_that_can_be_read(done, elapsed_s, unit, text):
    assert rate_text(done, elapsed_s, unit) == text


def test_sizes_are_sizes_while_they_are_fetched(capsys, monkeypatch):
    monkeypatch.setattr("tactile_toolkit.run.this_process._LINE_INTERVAL_S", 0.0)
    with Sink().progress("fetching", BYTES) as update:
        update(12_300_000, 45_600_000)
    assert capsys.readouterr().err.startswith("fetching: 12.3 MB of 45.6 MB, ")


@pytest.mark.parametrize(
    ("size", "text"),
    [
        (0, "0 B"),
        (999, "999 B"),
        (999.6, "1.0 kB"),
        (999_940, "999.9 kB"),
        (999_960, "1.0 MB"),
        (999_960_000, "1.0 GB"),
        (2.5e12, "2500.0 GB"),
    ],
)
def test_sizes_stay_below_a_thousand_of_their_unit(size: float, text: str) -> None:
    assert bytes_text(size) == text


def test_specifications_are_described_in_words():
    values = {
        "a": {"size_m": [0.1, 0.2], "on": True, "limit": None},
        "shapes": [{"name": "box"}, {"name": "disc"}],
    }
    assert _flat_lines(values) == [
        "a.size_m = 0.1, 0.2",
        "a.on = yes",
        "a.limit = none",
        "shapes.1.name = box",
        "shapes.2.name = disc",
    ]


@pytest.mark.parametrize(
    ("name", "words"),
    [("tset", "; did you mean 'test'?"), ("Train", "; did you mean 'train'?"), ("holdout", "")],
)
def test_mistyped_names_get_a_suggestion(name, words):
    assert did_you_mean(name, ["train", "test"]) == words


@pytest.mark.parametrize(
    ("seconds", "text"),
    [
        (0.4, "0 s"),
        (59.4, "59 s"),
        (59.7, "1 min 0 s"),
        (80, "1 min 20 s"),
        (3599.4, "59 min 59 s"),
        (3599.7, "1 h 0 min"),
        (3600, "1 h 0 min"),
        (3659, "1 h 0 min"),
        (7505, "2 h 5 min"),
        (90_000, "25 h 0 min"),
    ],
)
def test_durations_are_in_words(seconds: float, text: str) -> None:
    assert duration_text(seconds) == text
