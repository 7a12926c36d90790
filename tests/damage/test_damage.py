"""Damage is never served and ends in no traceback: a sample (more: ``python -m tests.damage.run``)."""

from __future__ import annotations

import subprocess
import sys
import time

import pytest
from hypothesis import settings


@pytest.mark.thorough
def test_damage_is_named_or_found() -> None:
    """Other damage in each run, the same where properties draw the same examples too."""
    trials = settings.default.max_examples // 4
    seed = 2026 if settings.default.derandomize else int(time.time())
    command = [sys.executable, "-m", "tests.damage.run", "--seed", str(seed), "--trials", str(trials)]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 0, f"seed {seed}\n{done.stdout[-8000:]}{done.stderr[-4000:]}"
    assert f"{trials} trials, 0 bad ends" in done.stdout
