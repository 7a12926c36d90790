"""Figures of a data set of digits as plots: how many of each class, and how their measures spread."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from mnist3d.dataset import MeshDataset
from mnist3d.report import REPORT_FILE
from tactile_toolkit.errors import InputError
from tactile_toolkit.pictures.plots import Bars, Spread, plot_bars, plot_spreads
from tactile_toolkit.pictures.writing import Drawing
from tactile_toolkit.store.folder import DataFolder
from tactile_toolkit.store.reports import read_report
from tactile_toolkit.wording import counted

__all__ = ["class_counts", "distributions", "histogram", "measures", "require_report"]

_MM3_PER_CM3 = 1000.0


def class_counts(dataset: MeshDataset) -> tuple[int, ...]:
    """Count the digits of each class; reads the label column only."""
    return tuple(np.bincount(dataset.labels, minlength=len(dataset.label_names)).tolist())


def histogram(datasets: Mapping[str, MeshDataset], title: str) -> Drawing:
    """Draw the number of digits of each class, a panel for each split."""
    panels = [
        Bars(
            f"{split}: {counted(len(dataset), 'digits')}",
            dataset.label_names,
            class_counts(dataset),
            "class",
            "digits",
        )
        for split, dataset in datasets.items()
    ]
    return Drawing(plot_bars(panels, title))


def require_report(folder: DataFolder) -> None:
    """Refuse a data set without its report of printability.

    Raises
    ------
    InputError
        The report is missing.
    """
    if not folder.exists(REPORT_FILE):
        message = (
            f"distributions need {REPORT_FILE}, which {folder.address()!r} does not hold; next: give the "
            "folder of a data set made by `mnist3d generate`"
        )
        raise InputError(message)


def measures(folder: DataFolder, splits: Sequence[str]) -> dict[str, Any]:
    """Read the report's rows of some splits, as Arrow tables by split.

    Raises
    ------
    IntegrityError
        The report is damaged.
    """
    report = read_report(folder, REPORT_FILE)
    of_row = np.asarray(report["split"].to_pylist())
    return {split: report.filter(of_row == split) for split in splits}


def distributions(
    folder: DataFolder, splits: Sequence[str], least_wall_mm: float | None, title: str
) -> Drawing:
    """Draw how height, volume, number of vertices and thinnest wall spread over each split.

    Parameters
    ----------
    folder : DataFolder
        The data set.
    splits : sequence of str
        Which splits.
    least_wall_mm : float or None
        Walls thinner than this are warned of; drawn as a line.
    title : str
        Heading.
    """
    tables = {name: table for name, table in measures(folder, splits).items() if len(table)}

    def spread(heading: str, label: str, column: str, unit: float = 1.0, **more: Any) -> Spread:
        groups = [(name, np.asarray(table[column].to_numpy()) / unit) for name, table in tables.items()]
        return Spread(heading, label, tuple(groups), "digits", together="all splits", **more)

    limit = None if least_wall_mm is None else (least_wall_mm, f"warned of below {least_wall_mm:g} mm")
    panels = (
        spread("Height", "mm", "size_z_mm"),
        spread("Volume", "cm³", "volume_mm3", _MM3_PER_CM3),
        spread("Vertices", "vertices of a mesh", "vertices"),
        spread("Thinnest wall", "mm", "thinnest_wall_mm", limit=limit),
    )
    return Drawing(plot_spreads(panels, title))
