"""Damage is never served and ends in no traceback: a sample (more: ``python -m tests.damage.run``)."""

from __future__ import annotations

import subprocess
import sys


def test_damage_is_named_or_found() -> None:
    command = [sys.executable, "-m", "tests.damage.run", "--seed", "2026", "--trials", "140"]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout[-8000:] + done.stderr[-4000:]
    assert "140 trials, 0 bad ends" in done.stdout
