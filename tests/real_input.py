"""The folder of real input next to the repository, which may be missing."""

from __future__ import annotations

from pathlib import Path

import pytest

__all__ = ["NO_REAL_INPUT", "SHARED", "needs_shared"]

SHARED = Path(__file__).resolve().parents[2] / "shared"
NO_REAL_INPUT = "real input is not here: the folder ../shared next to the repository is absent"
needs_shared = pytest.mark.skipif(not SHARED.is_dir(), reason=NO_REAL_INPUT)
