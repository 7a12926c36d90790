"""Reports of policies: every metric of an environment over seeds, with intervals over objects.

The protocol is that of the paper: the average over the steps of an episode and its final value, means over
seeds. An interval is that of other objects: it holds 95 % of the means of objects that are drawn again.
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

import numpy as np

from tactile_envs.episodes import policies
from tactile_envs.episodes.playing import EpisodeSpec, episodes_of
from tactile_envs.episodes.policies import Policy
from tactile_toolkit import cards, checked_fields, errors, run, store, wording
from tactile_toolkit.array_types import Float64, Int64
from tactile_toolkit.errors import InputError
from tactile_toolkit.json_types import JsonObject

_RESAMPLED = 2000
_INTERVAL = (2.5, 97.5)
_LIBRARIES = ("tactile-toolkit", "ap-gym", "gymnasium", "numpy", "scipy", "numba")
REPORT_FILES = ("report.json", "report.md", "report.png")
"""Files of a report."""

Curves = tuple[Int64, dict[str, Float64]]
"""Object of each episode (n,), and each metric at all of its steps (n, T)."""


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
    """Result of :func:`evaluate`.

    Attributes
    ----------
    protocol : mapping
        What must agree between reports that are compared: environment, settings, episodes, seeds, objects.
    policy : mapping
        Name and digest of the policy.
    metrics : mapping
        Results by the name of the metric.
    run : mapping
        Versions, processor, date and duration, which change no figure.
    """

    protocol: JsonObject
    policy: JsonObject
    metrics: Mapping[str, Metric]
    run: JsonObject

    def contents(self) -> dict[str, bytes]:
        """Return the files of a report by name: JSON, Markdown and the curves; needs matplotlib."""
        json_text = wording.printable_json(asdict(self))
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
        file = Path(path) / REPORT_FILES[0]
        try:
            stored = json.loads(file.read_bytes())
            metrics = {
                name: Metric(Summary(**values["average"]), Summary(**values["final"]), values["by_step"])
                for name, values in stored["metrics"].items()
            }
            return cls(stored["protocol"], stored["policy"], metrics, stored["run"])
        except (OSError, ValueError, KeyError, TypeError) as error:
            raise InputError(
                f"{str(file)!r} is no report: {error}",
                next="name a folder that `tactile-envs evaluate` wrote",
            ) from error


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
    specs = [replace(spec, seed=spec.seed + number) for number in range(seeds)]
    made = policies.policy_named(policy)
    facts = policies.fingerprint(made)
    objects = episodes_of(spec).env.objects()
    groups = [(own, group) for own in specs for group in range(-(-spec.episodes // spec.num_envs))]
    held: dict[tuple[int, int], Curves] = {}
    for number, curves in run.runner_for(workers).run(partial(_curves, made), groups):
        held[number] = curves
        on_progress(len(held), len(groups))
    keys = [(own.seed, group) for own, group in groups]
    rows = np.concatenate([held[key][0] for key in keys])
    metrics = {
        name: _metric(rows, np.concatenate([held[key][1][name] for key in keys])) for name in held[keys[0]][1]
    }
    protocol = {
        **spec.to_dict(),
        "seeds": seeds,
        "split": spec.split,
        "objects": objects.files,
    }
    facts_of_run = {
        "versions": {name: version(name) for name in _LIBRARIES},
        "processor": platform.processor() or platform.machine(),
        "date": time.strftime("%Y-%m-%d"),
        "duration_s": round(time.monotonic() - start_s, 1),
    }
    return Report(protocol, facts, metrics, facts_of_run)


def _curves(policy: Policy, group: tuple[EpisodeSpec, int]) -> tuple[tuple[int, int], Curves]:
    """Play a group of episodes of a seed; return the key of the group, and its curves."""
    spec, number = group
    episodes = episodes_of(spec)
    count = min(spec.num_envs, spec.episodes - number * spec.num_envs)
    values: dict[str, Float64] = {}
    objects: Int64 | None = None
    for _, taken in episodes.play(policy, number):
        if objects is None:
            objects = episodes.env.current_data_point_indices
        if taken is None:
            break
        for name, curve in taken.curves.items():
            if name.startswith("_"):
                continue
            ended = taken.curves[f"_{name}"] & taken.has_action
            whole = values.setdefault(name, np.full((spec.num_envs, episodes.env.config.step_limit), np.nan))
            whole[ended, : curve.shape[1]] = curve[ended]
    assert objects is not None, "a group has a touch"
    return (spec.seed, number), (objects[:count], {name: whole[:count] for name, whole in values.items()})


def _metric(objects: Int64, curves: Float64) -> Metric:
    """Summarise a metric at all steps (n, T) of episodes with some objects (n,); NaN after their end."""
    steps = (~np.isnan(curves)).sum(axis=1)
    final = curves[np.arange(len(curves)), steps - 1]
    by_step = np.nanmean(curves, axis=0)
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


def compare(reports: Mapping[str, Report]) -> list[tuple[str, ...]]:
    """Return a table of several reports: metric, then mean and interval of each, average and final.

    Raises
    ------
    InputError
        The reports are not of one protocol; names what differs.
    """
    first_name, first = next(iter(reports.items()))
    for name, report in reports.items():
        for key, value in first.protocol.items():
            if report.protocol.get(key) != value:
                values = (wording.shortened(str(held), 80) for held in (value, report.protocol.get(key)))
                raise InputError(
                    f"the reports {first_name!r} and {name!r} have another protocol: {key} is "
                    f"{' and '.join(values)}",
                    next="evaluate both policies with the same options and objects",
                )
    return [
        (metric, kind, *(_text(getattr(report.metrics[metric], kind)) for report in reports.values()))
        for metric in first.metrics
        for kind in ("average", "final")
    ]


def draw_curves(reports: Mapping[str, Report]) -> bytes:
    """Draw each metric of some reports by step and return the PNG; MissingExtraError without matplotlib."""
    with errors.needs_extra("the picture of a report", "matplotlib", "pictures"):
        from matplotlib.figure import Figure
    metrics = next(iter(reports.values())).metrics
    figure = Figure(figsize=(5 * len(metrics), 3.6), layout="constrained")
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
