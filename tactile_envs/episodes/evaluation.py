"""Evaluation of policies: every metric of an environment over seeds, with intervals over objects.

The protocol is that of the paper: the average over the steps of an episode and its final value, means over
seeds. An interval is that of other objects: it holds 95 % of the means of objects that are drawn again.
"""

from __future__ import annotations

import platform
import time
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from importlib.metadata import version
from typing import NamedTuple

import numpy as np

from tactile_envs.episodes import policies
from tactile_envs.episodes.playing import EpisodeSpec, episodes_of
from tactile_envs.episodes.policies import Policy
from tactile_envs.episodes.reports import Metric, Report, Summary
from tactile_toolkit import checked_fields, run
from tactile_toolkit.value_types import Float64, Int64

_RESAMPLED = 2000
_INTERVAL = (2.5, 97.5)
_LIBRARIES = ("tactile-toolkit", "ap-gym", "gymnasium", "numpy", "scipy", "numba")


class Curves(NamedTuple):
    """Objects and returns of episodes, (n,) each, and metrics at all of their steps, (n, T)."""

    objects: Int64
    returns: Float64
    metrics: dict[str, Float64]


def evaluate(
    spec: EpisodeSpec,
    policy: str | Policy,
    *,
    seeds: int = 5,
    workers: int | run.Runner = 1,
    on_progress: Callable[[int, int], None] = lambda done, total: None,
) -> Report:
    """Evaluate a policy: all metrics of its episodes, over several seeds.

    Parameters
    ----------
    spec : EpisodeSpec
        Environment, and number of episodes of each seed; ``spec.seed`` is the first seed.
    policy : str or callable
        As for :func:`tactile_envs.record`.
    seeds : int
        Number of seeds.
    workers : int or Runner
        Number of processes; the report is the same for any number. With several, the policy must be
        picklable.
    on_progress : callable
        Called with the number of groups of episodes that are finished, and that of all.

    Returns
    -------
    Report
        The figures, and what decided them.

    Raises
    ------
    InputError
        The id, a setting, the policy or the objects cannot be used.
    """
    start_s = time.monotonic()
    checked_fields.checked_integer(seeds, "seeds", 1)
    made = policies.policy_named(policy)
    facts = policies.fingerprint(made)
    env = episodes_of(spec).env
    protocol = {**spec.to_dict(), "weights": spec.weights_sha256(), "seeds": seeds, "split": env.split}
    protocol["objects"] = env.objects().files
    played = _played(spec, made, seeds, workers, on_progress)
    objects, returns = (
        np.concatenate([getattr(group, name) for group in played]) for name in Curves._fields[:2]
    )
    metrics = {
        name: _metric(objects, np.concatenate([group.metrics[name] for group in played]))
        for name in played[0].metrics
    }
    facts_of_run = {
        "versions": {name: version(name) for name in _LIBRARIES},
        "processor": platform.processor() or platform.machine(),
        "date": time.strftime("%Y-%m-%d"),
        "duration_s": round(time.monotonic() - start_s, 1),
    }
    return Report(protocol, facts, _summary(objects, returns), metrics, facts_of_run)


def _played(
    spec: EpisodeSpec,
    policy: Policy,
    seeds: int,
    workers: int | run.Runner,
    on_progress: Callable[[int, int], None],
) -> list[Curves]:
    """Play the groups of all seeds, in any order; return their curves, seed by seed."""
    specs = [replace(spec, seed=spec.seed + number) for number in range(seeds)]
    groups = [(seeded, group) for seeded in specs for group in range(-(-spec.episodes // spec.num_envs))]
    played: dict[tuple[int, int], Curves] = {}
    for key, curves in run.runner_for(workers).run(partial(_curves, policy), groups):
        played[key] = curves
        on_progress(len(played), len(groups))
    return [played[seeded.seed, group] for seeded, group in groups]


def _curves(policy: Policy, group: tuple[EpisodeSpec, int]) -> tuple[tuple[int, int], Curves]:
    """Play a group of episodes of a seed; return the key of the group, and its curves."""
    spec, number = group
    episodes = episodes_of(spec)
    count = min(spec.num_envs, spec.episodes - number * spec.num_envs)
    values: dict[str, Float64] = {}
    objects: Int64 | None = None
    returns = np.zeros(spec.num_envs)
    for _, taken in episodes.play(policy, number):
        if objects is None:
            objects = episodes.env.current_data_point_indices
        if taken is None:
            break
        returns += np.where(taken.has_action, taken.rewards, 0)
        for name, curve in taken.curves.items():
            if name.startswith("_"):
                continue
            ended = taken.curves[f"_{name}"] & taken.has_action
            whole = values.setdefault(name, np.full((spec.num_envs, episodes.env.config.step_limit), np.nan))
            whole[ended, : curve.shape[1]] = curve[ended]
    assert objects is not None, "a group has a touch"
    metrics = {name: whole[:count] for name, whole in values.items()}
    return (spec.seed, number), Curves(objects[:count], returns[:count], metrics)


def _metric(objects: Int64, curves: Float64) -> Metric:
    """Summarise a metric at all steps (n, T) of episodes with some objects (n,); NaN after their end."""
    steps = (~np.isnan(curves)).sum(axis=1)
    final = curves[np.arange(len(curves)), steps - 1]
    by_step = np.nanmean(curves[:, : steps.max()], axis=0)  # no episode is longer
    return Metric(_summary(objects, np.nanmean(curves, axis=1)), _summary(objects, final), by_step.tolist())


def _summary(objects: Int64, values: Float64) -> Summary:
    """Return the mean of episodes, and its interval if objects are drawn again with all of their episodes."""
    _, numbers = np.unique(objects, return_inverse=True)
    sums, counts = np.bincount(numbers, values), np.bincount(numbers)
    rng = np.random.default_rng(0)
    drawn = rng.integers(len(sums), size=(_RESAMPLED, len(sums)))
    means = sums[drawn].sum(axis=1) / counts[drawn].sum(axis=1)
    low, high = np.percentile(means, _INTERVAL)
    return Summary(float(values.mean()), float(low), float(high))
