"""Evaluation of policies: every metric of an environment over seeds, with intervals over objects; reports.

The protocol is that of the paper: the average over the steps of an episode and its final value, means over
seeds. An interval is that of other objects: it holds 95 % of the means of objects that are drawn again.

Reports are stored, compared and drawn. They are files of others: they are read as data sets are, bounded and
checked.
"""

from __future__ import annotations

import io
import json
import os
import platform
import time
from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass, replace
from functools import partial
from importlib.metadata import version
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from tactile_envs.episodes import policies
from tactile_envs.episodes.playing import EpisodeSpec, episodes_of
from tactile_envs.episodes.policies import Policy
from tactile_toolkit import cards, checked_fields, errors, run, store, wording
from tactile_toolkit.errors import InputError
from tactile_toolkit.value_types import Float64, Int64, JsonDict, JsonObject

if TYPE_CHECKING:
    from matplotlib.figure import Figure

REPORT_FILES = ("report.json", "report.md", "report.png")
"""Files of a report."""
_MAX_BYTES = 64 << 20  # of report.json: 100,000 steps of 20 metrics
_RESAMPLED = 2000
_INTERVAL = (2.5, 97.5)
_LIBRARIES = ("tactile-toolkit", "ap-gym", "gymnasium", "numpy", "scipy", "numba")


@dataclass(frozen=True)
class Summary:
    """Mean of a metric, and the bounds of its 95 % interval over objects."""

    mean: float
    low: float
    high: float


@dataclass(frozen=True)
class Metric:
    """A metric: the mean over the steps of an episode, its last value, and its mean at each step."""

    average: Summary
    final: Summary
    by_step: list[float]


@dataclass(frozen=True)
class Report:
    """Result of :func:`tactile_envs.evaluate`.

    Attributes
    ----------
    protocol : mapping
        What must agree between reports that are compared: environment, settings, episodes, seeds, objects.
    policy : mapping
        Name and digest of the policy.
    returns : Summary
        Sum of the rewards of an episode, not discounted.
    metrics : mapping
        Results by the name of the metric.
    run : mapping
        Versions, processor, date and duration, which change no figure.
    """

    protocol: JsonObject
    policy: JsonObject
    returns: Summary
    metrics: Mapping[str, Metric]
    run: JsonObject

    def contents(self) -> dict[str, bytes]:
        """Return the files of a report by name: JSON, Markdown and the curves; needs matplotlib."""
        json_text = json.dumps(asdict(self), indent=2)
        texts = {REPORT_FILES[0]: json_text, REPORT_FILES[1]: self.markdown()}
        files = {name: text.encode() for name, text in texts.items()}
        return files | {REPORT_FILES[2]: draw_curves({str(self.policy["name"]): self})}

    def write(self, out: str | os.PathLike[str], *, overwrite: bool = False) -> None:
        """Write ``report.json``, ``report.md`` and ``report.png`` into a folder.

        Raises InputError if one exists and `overwrite` is False; MissingExtraError without matplotlib.
        """
        store.open_output(Path(out), REPORT_FILES, overwrite=overwrite).write(self.contents())

    def markdown(self) -> str:
        """Return the figures and what decided them as Markdown."""
        protocol = self.protocol
        name = str(self.policy["name"])
        table = cards.markdown_table(("metric", "", f"{name}: mean (95 % interval)"), compare({name: self}))
        files = wording.with_count(len(protocol["objects"]), "files")
        decided = [
            ("environment", f"`{protocol['env_id']}`"),
            ("settings", wording.markdown_code(json.dumps(protocol["settings"]))),
            ("episodes of each seed", protocol["episodes"]),
            ("seeds", protocol["seeds"]),
            ("objects", f"split {protocol['split']}, {files}"),
            ("policy", f"{wording.markdown_code(name)}, SHA-256 {self.policy['sha256']}"),
            *((key.replace("_", " "), value) for key, value in self.run.items() if key != "versions"),
            ("versions", ", ".join(f"{key} {value}" for key, value in self.run["versions"].items())),
        ]
        return (
            f"# {name} in {protocol['env_id']}\n\n{table}\n\n![Curves](report.png)\n\n"
            f"{cards.markdown_table(('', ''), decided)}\n"
        )

    @classmethod
    def read(cls, path: str | os.PathLike[str]) -> Report:
        """Read the report of a folder; InputError if there is none, or it is damaged."""
        folder = store.open_folder(os.fspath(path))
        address = folder.address(REPORT_FILES[0])
        try:
            with folder.open_inside(REPORT_FILES[0]) as stream:
                return store.decode(stream.read(_MAX_BYTES), cls, address)
        except (errors.ItemError, errors.IntegrityError) as error:
            raise InputError(
                f"{address!r} is no report: {error.what}",
                next="name a folder that `tactile-envs evaluate` wrote",
            ) from error


def compare(reports: Mapping[str, Report]) -> list[tuple[str, ...]]:
    """Return a table of several reports: metric, then mean and interval of each, average, final or sum.

    Raises
    ------
    InputError
        The reports are not of one protocol; names what differs.
    """
    first_name, first = next(iter(reports.items()))
    for name, report in reports.items():
        both = [_compared(first), _compared(report)]
        for key in dict.fromkeys([*both[0], *both[1]]):
            values = [protocol.get(key) for protocol in both]
            if values[0] != values[1]:
                shown = " and ".join(wording.shortened(str(value), 80) for value in values)
                raise InputError(
                    f"the reports {first_name!r} and {name!r} have another protocol: {key} is {shown}",
                    next="evaluate both policies with the same options and objects",
                )
    metrics = [
        (metric, kind, *(_text(getattr(report.metrics[metric], kind)) for report in reports.values()))
        for metric in first.metrics
        for kind in ("average", "final")
    ]
    return [*metrics, ("return", "sum", *(_text(report.returns) for report in reports.values()))]


def _compared(report: Report) -> JsonDict:
    """Return all that must agree between two reports."""
    return {**report.protocol, "metrics": list(report.metrics)}


def figure_class() -> type[Figure]:
    """Return matplotlib's class of figures; MissingExtraError without matplotlib."""
    with errors.needs_extra("the picture of a report", "matplotlib", "pictures"):
        from matplotlib.figure import Figure
    figure: type[Figure] = Figure
    return figure


def draw_curves(reports: Mapping[str, Report]) -> bytes:
    """Draw each metric of some reports by step and return the PNG; MissingExtraError without matplotlib."""
    metrics = next(iter(reports.values())).metrics
    figure = figure_class()(figsize=(5 * len(metrics), 3.6), layout="constrained")
    for axes, metric in zip(figure.subplots(1, len(metrics), squeeze=False)[0], metrics, strict=True):
        for name, report in reports.items():
            curve = report.metrics[metric].by_step
            axes.plot(range(1, len(curve) + 1), curve, label=name)
        axes.set(xlabel="step", ylabel=metric.replace("_", " "))
        axes.legend(frameon=False)
    stream = io.BytesIO()
    figure.savefig(stream, dpi=150)
    return stream.getvalue()


def _text(summary: Summary) -> str:
    return f"{summary.mean:.4g} ({summary.low:.4g} to {summary.high:.4g})"


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
