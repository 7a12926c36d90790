"""The log of the metrics of episodes."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from tactile_toolkit.array_types import AnyArray, Bool, Float32


class EpisodeLog:
    """Metrics of the steps of environments whose episodes begin and end together.

    Gives means, last values and curves, like the log wrappers of ap-gym 0.7.1.
    """

    def __init__(self, num_envs: int, step_limit: int) -> None:
        self._num_envs = num_envs
        self._step_limit = step_limit
        self._values: dict[str, Float32] = {}

    def add(self, step: int, metrics: Mapping[str, AnyArray]) -> None:
        """Add the metrics of a step, counted from 0, an array (n,) each."""
        for name, values in metrics.items():
            if name not in self._values:
                self._values[name] = np.empty((self._step_limit, self._num_envs), np.float32)
            self._values[name][step] = values

    def stats(self) -> dict[str, Any]:
        """Return ``info["stats"]`` of a finished episode."""
        done = np.ones(self._num_envs, np.bool_)
        scalar: dict[str, Any] = {}
        vector: dict[str, Any] = {}
        for name, values in self._values.items():
            for kind, reduced in (("avg", values.mean(axis=0)), ("final", values[-1].copy())):
                scalar[f"{kind}_{name}"], scalar[f"_{kind}_{name}"] = reduced, done
            vector[name], vector[f"_{name}"] = values.T.copy(), done
        if "accuracy" in self._values:
            scalar.update(_turning_points(self._values["accuracy"] > 0))
        return {"scalar": scalar, "_scalar": done, "vector": vector, "_vector": done}


def _turning_points(is_right: Bool) -> dict[str, Any]:
    """Return the first right step and the last wrong step, and which environments have one."""
    ever, always = is_right.any(axis=0), is_right.all(axis=0)
    last_wrong = len(is_right) - 1 - np.argmin(is_right[::-1], axis=0)
    return {
        "first_correct": np.where(ever, np.argmax(is_right, axis=0), -1).astype(np.int32),
        "_first_correct": ever,
        "last_incorrect": np.where(always, -1, last_wrong).astype(np.int32),
        "_last_incorrect": ~always,
    }
