"""Reports of policies: how they are stored, compared and drawn.

Reports are files of others: they are read as data sets are, bounded and checked.
"""

from __future__ import annotations

import io
import json
import os
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from tactile_toolkit import cards, errors, store, wording
from tactile_toolkit.errors import InputError
from tactile_toolkit.value_types import JsonDict, JsonObject

if TYPE_CHECKING:
    from matplotlib.figure import Figure

REPORT_FILES = ("report.json", "report.md", "report.png")
"""Files of a report."""
_MAX_BYTES = 64 << 20  # of report.json: 100,000 steps of 20 metrics


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
