"""Use of a provider in another process; in a separate module, so that spawned processes import little."""

from __future__ import annotations

import multiprocessing
from typing import Any

import numpy as np

from env_assets import top_surface
from tests.processes import PATIENCE_S

__all__ = ["fingerprint", "seen_by_a_child"]


def fingerprint(provider: Any) -> list[Any]:
    """Read a little of all assets."""
    digits = provider.meshes("mnist3d", "test")
    return [
        len(digits),
        digits.ids.tolist(),
        [float(record.mesh.volume) for record in digits],
        float(np.nansum(top_surface(digits[0], 0.001).heights_m)),
        provider.touches("real-single").ids.tolist(),
        provider.meshes("starstruck").volumes_m3.tolist(),
    ]


def _answer(provider: Any, queue: Any) -> None:
    queue.put(fingerprint(provider))


def seen_by_a_child(provider: Any, method: str) -> list[Any]:
    """Start a process, and return the result of its use of a provider."""
    context = multiprocessing.get_context(method)
    queue = context.Queue()
    process = context.Process(target=_answer, args=(provider, queue))
    process.start()
    found: list[Any] = queue.get(timeout=PATIENCE_S)
    process.join(PATIENCE_S)
    assert process.exitcode == 0
    queue.close()
    queue.join_thread()
    return found
