"""The command `tactile`, which finds the other commands."""

from __future__ import annotations

import subprocess
import sys

import pytest

from tests.command_line import call


@pytest.mark.parametrize("words", [(), ("--help",), ("-h",)])
def test_it_lists_all_commands(words, capsys):
    assert call("tactile", *words) == 0
    out = capsys.readouterr().out
    for name, command in {
        "digits": "mnist3d",
        "scenes": "starstruck",
        "touches": "realtouch",
        "sim": "tactile-sim",
        "assets": "env-assets",
    }.items():
        assert f"tactile {name} ... = {command} ..." in out


@pytest.mark.parametrize("names", [("digits", "mnist3d"), ("sim", "tactile-sim"), ("assets", "env-assets")])
def test_a_word_leads_to_a_command(names, capsys):
    said = []
    for line in (("tactile", names[0]), ("tactile", names[1]), (names[1],)):
        assert call(*line, "list" if names[0] != "sim" else "info", "-h") == 0
        said.append(capsys.readouterr().out)
    assert said[0] == said[1] == said[2] != ""


def test_an_unknown_word_is_an_error(capsys):
    assert call("tactile", "digit") == 2
    assert "did you mean 'digits'" in capsys.readouterr().err


@pytest.mark.thorough
def test_python_runs_it_too():
    done = subprocess.run(
        [sys.executable, "-m", "tactile_toolkit", "digits", "--version"],
        capture_output=True,
        text=True,
        check=False,
    )
    assert (done.returncode, done.stdout[:16]) == (0, "tactile-toolkit ")


def test_a_token_is_accepted_only_by_commands_of_the_hub(capsys):
    for line, takes in {
        ("mnist3d", "generate"): False,
        ("starstruck", "generate"): False,
        ("mnist3d", "cache"): False,
        ("mnist3d", "solidify"): False,
        ("mnist3d", "verify"): False,
        ("tactile-sim", "train"): False,
        ("tactile-sim", "pairs"): True,
        ("env-assets", "wrench"): False,
        ("mnist3d", "upload"): True,
        ("mnist3d", "download"): True,
        ("mnist3d", "info"): True,
        ("realtouch", "list"): True,
    }.items():
        assert call(*line, "--help") == 0
        assert ("--token" in capsys.readouterr().out) is takes, line
