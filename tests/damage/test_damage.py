"""Damage is never served and ends in no traceback: a sample (more: ``python -m tests.damage.run``)."""

from __future__ import annotations

import os
import subprocess
import sys
import time

from hypothesis import settings


def test_damage_is_named_or_found() -> None:
    """The same sample everywhere, another one where properties draw fresh examples too."""
    trials = settings.default.max_examples // 3
    seed = int(time.time()) if os.environ.get("FRESH_EXAMPLES") else 2026
    command = [sys.executable, "-m", "tests.damage.run", "--seed", str(seed), "--trials", str(trials)]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 0, f"seed {seed}\n{done.stdout[-8000:]}{done.stderr[-4000:]}"
    assert f"{trials} trials, 0 bad ends" in done.stdout
