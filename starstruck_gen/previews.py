"""Pictures of scenes: contact sheets, single scenes with their rejected positions, class counts."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property, partial
from pathlib import Path

import numpy as np

from starstruck_gen.dataset import SceneMeshDataset, SceneRecord, load
from starstruck_gen.kind import KIND
from starstruck_gen.preview_scene import draw_one, draw_sheet
from starstruck_gen.spec import SceneSpec
from tactile_toolkit.catalog.choose import chosen_records, class_by_class, open_splits
from tactile_toolkit.catalog.kinds import require_kind
from tactile_toolkit.errors import InputError
from tactile_toolkit.pictures.plots import Bars, plot_bars, require_plots
from tactile_toolkit.pictures.render import Studio
from tactile_toolkit.pictures.writing import (
    Drawing,
    PicturePlan,
    PlannedPicture,
    chosen_kinds,
    file_stem,
    plan_kinds,
)
from tactile_toolkit.store.folder import DataFolder
from tactile_toolkit.store.manifest import read_manifest
from tactile_toolkit.wording import counted

__all__ = ["KINDS", "PreviewSpec", "plan_previews"]

KINDS = ("sheet", "scene", "histogram")
_USUAL = ("sheet", "histogram")


@dataclass(frozen=True, slots=True)
class PreviewSpec:
    """What to draw.

    Attributes
    ----------
    kinds : tuple of str
        Some of :data:`KINDS`, or ``"all"``. When empty: single scenes where ids are given, else sheet and
        histogram.
    split : str or None
        Split of a data set; all of them by default.
    ids : tuple of int
        Scenes to draw. When empty: the first of each class on a sheet, the first scene alone.
    per_class : int
        Scenes of each class on a sheet.
    """

    kinds: tuple[str, ...] = ()
    split: str | None = None
    ids: tuple[int, ...] = ()
    per_class: int = 8

    def __post_init__(self) -> None:
        if self.per_class < 1:
            message = f"--per-class is {self.per_class}; expected a whole number of at least 1"
            raise InputError(message)


def plan_previews(name: str, spec: PreviewSpec) -> PicturePlan:
    """Decide which pictures of a data set of scenes to draw; draws none.

    Parameters
    ----------
    name : str
        A data set folder or a Parquet file.
    spec : PreviewSpec
        What to draw.

    Returns
    -------
    PicturePlan

    Raises
    ------
    InputError
        No such place, kind, split or id; an empty set; no data set of scenes.
    MissingExtraError
        Plots were asked for by name and matplotlib is not installed.
    IntegrityError
        The data set is damaged or unfinished.
    """
    place = Path(name).expanduser()
    if not place.is_dir() and not (place.is_file() and place.suffix.lower() == ".parquet"):
        message = f"{name!r} is no folder and no Parquet file; expected a data set of scenes"
        raise InputError(message)
    opened = _OpenSet(name, spec)
    kinds, by_name = chosen_kinds(spec.kinds, KINDS, ("scene",) if spec.ids else _USUAL)
    if spec.ids:
        opened.records()
    return plan_kinds(kinds, by_name, lambda kind: _PLANS[kind](opened))


class _OpenSet:
    """A data set and what to draw of it."""

    def __init__(self, name: str, spec: PreviewSpec) -> None:
        self.name, self.spec, self.stem = name, spec, file_stem(name)
        self.datasets = open_splits(name, spec.split, load, "scenes")
        require_kind(KIND, "preview", name, self.datasets.values())

    @cached_property
    def made_by(self) -> SceneSpec | None:
        """How the scenes were made; None where no manifest says it."""
        manifest = read_manifest(DataFolder(self.name)) if Path(self.name).expanduser().is_dir() else None
        return None if manifest is None else SceneSpec.from_dict(manifest.spec["scene"])

    def records(self) -> list[tuple[str, SceneRecord]]:
        """Return the scenes asked for with their splits, or the first of all.

        Raises
        ------
        InputError
            There is no scene of some id.
        """
        return chosen_records(self.datasets, self.spec.ids, self.name, "scene")


def _plan_sheets(opened: _OpenSet) -> list[PlannedPicture]:
    pictures = []
    for split, dataset in opened.datasets.items():
        rows = class_by_class(dataset, opened.spec.ids, opened.spec.per_class)
        if len(rows):
            made_by = opened.made_by or SceneSpec()
            title = f"{opened.stem}: {split}"
            draw = partial(_drawn_sheet, dataset[rows], made_by, opened.spec.per_class, title)
            what = f"{counted(len(rows), 'scenes')} of {split} from above"
            pictures.append(PlannedPicture(f"{opened.stem}-{split}-sheet.png", what, draw))
    return pictures


def _plan_scenes(opened: _OpenSet) -> list[PlannedPicture]:
    return [
        PlannedPicture(
            f"{opened.stem}-{split}-{record.id}-scene.png",
            f"scene {record.id} {_view(opened, record)}, and obliquely",
            partial(_drawn_scene, record, opened.made_by, f"Scene {record.id} ({opened.stem}, {split})"),
        )
        for split, record in opened.records()
    ]


def _view(opened: _OpenSet, record: SceneRecord) -> str:
    traceable = record.has_placements and opened.made_by is not None
    return "with rejected positions" if traceable else "from above"


def _plan_histogram(opened: _OpenSet) -> list[PlannedPicture]:
    require_plots("the class histogram")
    draw = partial(_drawn_histogram, opened.datasets, f"{opened.stem}: scenes of each class")
    known = any(dataset[0].has_placements for dataset in opened.datasets.values())
    what = "scenes of each class" + (" and number of others" if known else "")
    return [PlannedPicture(f"{opened.stem}-histogram.png", what, draw)]


_PLANS = {"sheet": _plan_sheets, "scene": _plan_scenes, "histogram": _plan_histogram}


def _drawn_sheet(dataset: SceneMeshDataset, spec: SceneSpec, per_row: int, title: str, _: Studio) -> Drawing:
    return draw_sheet(list(dataset), spec, per_row, title)


def _drawn_scene(record: SceneRecord, spec: SceneSpec | None, title: str, studio: Studio) -> Drawing:
    return draw_one(studio, record, spec, title)


def _drawn_histogram(datasets: Mapping[str, SceneMeshDataset], title: str, _: Studio) -> Drawing:
    panels = []
    for split, dataset in datasets.items():
        classes = np.bincount(dataset.labels, minlength=len(dataset.label_names))
        heading = f"{split}: {counted(len(dataset), 'scenes')}"
        panels.append(Bars(heading, dataset.label_names, tuple(classes.tolist()), "stars", "scenes"))
        if dataset[0].has_placements:
            others = np.bincount(dataset.column("distractor_count"))
            names = tuple(map(str, range(len(others))))
            panels.append(
                Bars(f"{split}: other objects", names, tuple(others.tolist()), "other objects", "scenes")
            )
    return Drawing(plot_bars(panels, title))
