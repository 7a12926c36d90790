"""The log of the metrics of episodes."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from tactile_envs import gym_types, reset_options
from tactile_toolkit.array_types import AnyArray, Bool, Float32, Int64


class EpisodeLog:
    """Metrics of the steps of some environments.

    Gives means, last values and curves, like the log wrappers of ap-gym 0.7.1.
    """

    def __init__(self, num_envs: int, step_limit: int) -> None:
        self._rows = np.arange(num_envs)
        self._step_limit = step_limit
        self._values: dict[str, Float32] = {}

    def add(self, steps: Int64, active: reset_options.Rows, metrics: Mapping[str, AnyArray]) -> None:
        """Add the metrics of a step of the active environments.

        Each of ``metrics`` has shape (n,), one value for each environment, active or not; ``steps``, shape
        (n,), are the numbers of their steps, from 0 on.
        """
        rows, at = self._rows[active], steps[active]
        for name, values in metrics.items():
            if name not in self._values:
                self._values[name] = np.full((self._step_limit, len(steps)), np.nan, np.float32)
            self._values[name][at, rows] = values[active]

    def stats(self, lengths: Int64, is_over: Bool) -> gym_types.Info:
        """Return ``info["stats"]`` when some episodes are over.

        ``lengths``, shape (n,), are the steps of the episodes so far, 1 at least where ``is_over``. Values of
        environments whose episode is not over are NaN, and their masks False; so are steps of curves after
        the end of a shorter episode.
        """
        scalar: gym_types.Info = {}
        vector: gym_types.Info = {}
        longest = int(lengths[is_over].max())
        for name, values in self._values.items():
            means, last = np.full((2, len(lengths)), np.nan, np.float32)
            curves = np.full((len(lengths), longest), np.nan, np.float32)
            for length in np.unique(lengths[is_over]):
                rows = self._rows[is_over & (lengths == length)]
                taken = values[:length, rows]
                means[rows], last[rows] = taken.mean(axis=0), taken[-1]
                curves[rows, :length] = taken.T
            for kind, reduced in (("avg", means), ("final", last)):
                scalar[f"{kind}_{name}"], scalar[f"_{kind}_{name}"] = reduced, is_over
            vector[name], vector[f"_{name}"] = curves, is_over
        if "accuracy" in self._values:
            is_taken = np.arange(self._step_limit)[:, None] < lengths
            scalar.update(_turning_points(self._values["accuracy"] > 0, is_taken))
        return {"scalar": scalar, "_scalar": is_over, "vector": vector, "_vector": is_over}


def _turning_points(is_right: Bool, is_taken: Bool) -> gym_types.Info:
    """Return the first right step and the last wrong step, and which environments have one.

    Both arrays have shape (steps, n); those of episodes that go on count too, as in ap-gym.
    """
    right, wrong = is_right & is_taken, ~is_right & is_taken
    ever, ever_wrong = right.any(axis=0), wrong.any(axis=0)
    last_wrong = len(wrong) - 1 - np.argmax(wrong[::-1], axis=0)
    return {
        "first_correct": np.where(ever, np.argmax(right, axis=0), -1).astype(np.int32),
        "_first_correct": ever,
        "last_incorrect": np.where(ever_wrong, last_wrong, -1).astype(np.int32),
        "_last_incorrect": ever_wrong,
    }
