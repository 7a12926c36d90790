"""Pictures of digits: contact sheets, single objects, steps, class counts, distributions."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property, partial
from pathlib import Path
from typing import Any

from mnist3d.dataset import MeshDataset, MeshRecord, load
from mnist3d.kind import KIND
from mnist3d.preview_figures import distributions, histogram, require_report
from mnist3d.preview_object import draw_object
from mnist3d.preview_sheet import draw_sheet
from mnist3d.preview_steps import draw_steps, source_option
from mnist3d.spec import SolidSpec
from tactile_toolkit.catalog.choose import chosen_records, class_by_class, open_splits
from tactile_toolkit.catalog.kinds import require_kind
from tactile_toolkit.errors import InputError, ItemError
from tactile_toolkit.mesh.files import FORMATS, read_mesh
from tactile_toolkit.mesh.mesh import Mesh
from tactile_toolkit.pictures.plots import require_plots
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

KINDS = ("sheet", "object", "steps", "histogram", "distributions")
_USUAL = ("sheet", "histogram", "distributions")
_IMAGES = (".png", ".jpg", ".jpeg", ".bmp", ".tif", ".tiff", ".webp")


@dataclass(frozen=True, slots=True)
class PreviewSpec:
    """What to draw.

    Attributes
    ----------
    kinds : tuple of str
        Some of :data:`KINDS`, or ``"all"``. When empty: single objects where ids are given, else sheet,
        histogram and distributions.
    split : str or None
        Split of a data set; all of them by default.
    ids : tuple of int
        Digits to draw. When empty: the first of each class on a sheet, the first digit as object and steps.
    per_class : int
        Digits of each class on a sheet.
    images, writer_info : Path or None
        Files of the source of the images, for the steps.
    """

    kinds: tuple[str, ...] = ()
    split: str | None = None
    ids: tuple[int, ...] = ()
    per_class: int = 10
    images: Path | None = None
    writer_info: Path | None = None

    def __post_init__(self) -> None:
        if self.per_class < 1:
            message = f"--per-class is {self.per_class}; expected a whole number of at least 1"
            raise InputError(message)


def plan_previews(name: str, spec: PreviewSpec) -> PicturePlan:
    """Decide which pictures of a data set, a mesh file or an image of a digit to draw; draws none.

    Parameters
    ----------
    name : str
        A data set folder, a Parquet file, a mesh file (STL, 3MF, PLY, OBJ, GLB), or a picture of a digit.
    spec : PreviewSpec
        What to draw.

    Returns
    -------
    PicturePlan

    Raises
    ------
    InputError
        No such place, kind, split or id; an empty set; a file that cannot be read.
    MissingExtraError
        Plots were asked for by name and matplotlib is not installed.
    IntegrityError
        The data set is damaged or unfinished.
    """
    place = Path(name).expanduser()
    if not place.exists():
        message = f"{name!r} does not exist; expected a data set folder, a Parquet file or a mesh file"
        raise InputError(message)
    ending = place.suffix.lower()
    if place.is_dir() or ending == ".parquet":
        return _plan_set(_OpenSet(name, spec))
    if ending in FORMATS:
        _require_only("object", spec, name)
        mesh = read_mesh(place)
        return _one(f"{file_stem(name)}-object.png", place.name, partial(_drawn_object, mesh, place.name))
    if ending in _IMAGES:
        _require_only("steps", spec, name)
        pixels = _digit_image(place)
        return _one(
            f"{file_stem(name)}-steps.png", place.name, partial(_drawn_steps, pixels, SolidSpec(), place.name)
        )
    known = ", ".join((".parquet", *FORMATS, *_IMAGES))
    message = f"{name!r} ends in {ending!r}; expected a folder, or a file ending in one of {known}"
    raise InputError(message)


class _OpenSet:
    """A data set and what to draw of it."""

    def __init__(self, name: str, spec: PreviewSpec) -> None:
        self.name, self.spec, self.stem = name, spec, file_stem(name)
        self.folder = DataFolder(name)
        self.datasets = open_splits(name, spec.split, load, "digits")
        require_kind(KIND, "preview", name, self.datasets.values())

    @cached_property
    def made_by(self) -> Mapping[str, Any]:
        """The specification in the manifest; empty where there is none."""
        manifest = read_manifest(self.folder) if Path(self.name).expanduser().is_dir() else None
        return manifest.spec if manifest is not None else {}

    def records(self) -> list[tuple[str, MeshRecord]]:
        """Return the digits asked for with their splits, or the first of all.

        Raises
        ------
        InputError
            There is no digit of some id.
        """
        return chosen_records(self.datasets, self.spec.ids, self.name, "digit")


def _plan_set(opened: _OpenSet) -> PicturePlan:
    usual = ("object",) if opened.spec.ids else _USUAL
    kinds, by_name = chosen_kinds(opened.spec.kinds, KINDS, usual)
    if opened.spec.ids:
        opened.records()
    return plan_kinds(kinds, by_name, lambda kind: _PLANS[kind](opened))


def _plan_sheets(opened: _OpenSet) -> list[PlannedPicture]:
    pictures = []
    for split, dataset in opened.datasets.items():
        rows = class_by_class(dataset, opened.spec.ids, opened.spec.per_class)
        if len(rows):
            draw = partial(_drawn_sheet, dataset[rows], opened.spec.per_class, f"{opened.stem}: {split}")
            what = f"{counted(len(rows), 'digits')} of {split} from above"
            pictures.append(PlannedPicture(f"{opened.stem}-{split}-sheet.png", what, draw))
    return pictures


def _plan_objects(opened: _OpenSet) -> list[PlannedPicture]:
    return [
        PlannedPicture(
            f"{opened.stem}-{split}-{record.id}-object.png",
            f"digit {record.id} from above and obliquely",
            partial(
                _drawn_object,
                Mesh(record.vertices_m, record.faces),
                _heading(opened, split, record),
            ),
        )
        for split, record in opened.records()
    ]


def _plan_steps(opened: _OpenSet) -> list[PlannedPicture]:
    if "source" not in opened.made_by:
        message = f"{opened.name!r} does not say where its images came from; next: give a picture of a digit"
        raise InputError(message)
    source = source_option(dict(opened.made_by["source"]), opened.spec.images, opened.spec.writer_info)
    solid = SolidSpec.from_dict(dict(opened.made_by["solid"]))
    return [
        PlannedPicture(
            f"{opened.stem}-{split}-{record.id}-steps.png",
            f"digit {record.id}, step by step",
            partial(_drawn_steps, source.image(record.id).pixels, solid, _heading(opened, split, record)),
        )
        for split, record in opened.records()
    ]


def _plan_histogram(opened: _OpenSet) -> list[PlannedPicture]:
    require_plots("the class histogram")
    draw = partial(_alone, histogram, opened.datasets, f"{opened.stem}: digits of each class")
    return [PlannedPicture(f"{opened.stem}-histogram.png", "digits of each class", draw)]


def _plan_distributions(opened: _OpenSet) -> list[PlannedPicture]:
    require_plots("the picture of distributions")
    require_report(opened.folder)
    least = opened.made_by.get("print_profile", {}).get("min_wall_mm")
    title = f"{opened.stem}: measures of the digits"
    draw = partial(_alone, distributions, opened.folder, tuple(opened.datasets), least, title)
    what = "height, volume, vertices and thinnest wall"
    return [PlannedPicture(f"{opened.stem}-distributions.png", what, draw)]


_PLANS = {
    "sheet": _plan_sheets,
    "object": _plan_objects,
    "steps": _plan_steps,
    "histogram": _plan_histogram,
    "distributions": _plan_distributions,
}


def _heading(opened: _OpenSet, split: str, record: MeshRecord) -> str:
    names = next(iter(opened.datasets.values())).label_names
    name = names[record.label] if record.label < len(names) else record.label
    return f"Digit {name}, id {record.id} ({opened.stem}, {split})"


def _drawn_sheet(dataset: MeshDataset, per_row: int, title: str, _: Studio) -> Drawing:
    return draw_sheet(list(dataset), per_row, title, dataset.label_names)


def _drawn_object(mesh: Mesh, title: str, studio: Studio) -> Drawing:
    return draw_object(studio, mesh, title)


def _drawn_steps(pixels: Any, solid: SolidSpec, title: str, studio: Studio) -> Drawing:
    try:
        return draw_steps(studio, pixels, solid, title)
    except ItemError as error:
        raise ItemError(error.reason, f"{title}: {error}") from error


def _alone(draw: Any, *parts: Any) -> Drawing:
    """Draw what needs no studio, which comes last."""
    drawing: Drawing = draw(*parts[:-1])
    return drawing


def _digit_image(place: Path) -> Any:
    from mnist3d.sources.canvas import fit
    from mnist3d.sources.picture import read_picture

    return fit(read_picture(place))


def _require_only(kind: str, spec: PreviewSpec, name: str) -> None:
    kinds, by_name = chosen_kinds(spec.kinds, KINDS, (kind,))
    if by_name and kinds != (kind,):
        other = next(each for each in kinds if each != kind)
        message = f"--kind {other} needs a data set, and {name!r} is a single file; next: give --kind {kind}"
        raise InputError(message)
    for option, value in (("--split", spec.split), ("--ids", spec.ids)):
        if value:
            message = f"{option} chooses from a data set, and {name!r} is a single file; next: leave it out"
            raise InputError(message)


def _one(name: str, what: str, draw: Any) -> PicturePlan:
    return PicturePlan((PlannedPicture(name, what, draw),))
