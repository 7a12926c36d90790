"""Files for printers, made from pictures."""

from __future__ import annotations

import glob
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image

from mnist3d import digit_options
from mnist3d.digit_previews import CLAY
from mnist3d.solid import algorithm, picture_ink
from mnist3d.sources.picture_files import is_picture_name, pages_of
from tactile_toolkit import mesh, pictures, printing, store, touch
from tactile_toolkit.errors import InputError, ItemError
from tactile_toolkit.value_types import Bool, UInt8

_VIEW_PX = (760, 560)
_PREVIEW = "-preview.png"
_MANY_TRIANGLES = 300_000


@dataclass(frozen=True)
class PrintSpec:
    """Options for making solids to print from pictures.

    Attributes
    ----------
    changes : mapping
        Parameters of :class:`~mnist3d.SolidSpec` in place of those for pictures.
    size : SolidSize
        Size of each solid.
    base_mm : float, optional
        Thickness of the plate below each solid.
    ink, threshold : str
        As for :func:`mnist3d.solidify`.
    profile : PrintProfile
        Printer and material of the report.
    ending : str
        Format of the files, one of :attr:`tactile_toolkit.mesh.MeshFile.FORMATS`.
    preview : bool
        Write a picture of each solid beside its file, ``NAME-preview.png``.
    """

    changes: Mapping[str, Any] = field(default_factory=dict)
    size: digit_options.SolidSize = field(default_factory=digit_options.SolidSize)
    base_mm: float | None = None
    ink: str = "auto"
    threshold: str = "auto"
    profile: mesh.PrintProfile = field(default_factory=mesh.PrintProfile)
    ending: str = ".stl"
    preview: bool = False

    def advice_options(self) -> dict[str, str]:
        """Return the options of ``mnist3d solidify`` that advice names (``PrintReport.advice``)."""
        joining = " by a base plate (--base-mm 2) or by bridges (--bridge-mm 3)"
        return {
            "larger": " (--height-mm, --width-mm or --pixel-mm)",
            "join": joining if self.base_mm is None else "",
            "plate": " (--base-mm 2)" if self.base_mm is None else "",
        }


@dataclass(frozen=True, slots=True)
class PrintedPicture:
    """A file that was made from a picture: its names, the report about the solid, and notes on the picture.

    ``state`` is as in ``tactile_toolkit.printing.Made``.
    """

    picture: str
    file: str
    report: mesh.PrintReport
    notes: tuple[str, ...]
    bytes: int
    state: str

    def to_dict(self) -> dict[str, Any]:
        """Return JSON values."""
        named = {"picture": self.picture, "file": self.file, "bytes": self.bytes, "state": self.state}
        return {**named, **self.report.to_row(), "notes": list(self.notes)}


def print_pictures(
    names: Sequence[str],
    out: str,
    spec: PrintSpec,
    *,
    overwrite: bool = False,
    dry_run: bool = False,
    workers: int = 1,
    on_progress: Callable[[int, int], None] = lambda _done, _total: None,
) -> printing.FileExport[PrintedPicture]:
    """Make a file of each picture, named after it; each page of a TIFF or GIF is a picture.

    Parameters
    ----------
    names : sequence of str
        Pictures, and folders of pictures.
    out : str
        A file, whose ending is then the format, for one picture; else a folder.
    spec : PrintSpec
        How pictures become solids.
    overwrite, dry_run, workers, on_progress
        As for ``tactile_toolkit.printing.export_files``.

    Returns
    -------
    FileExport
        Files, and pictures that could not be used with the reason.

    Raises
    ------
    InputError
        A name is no picture or folder, two pictures have the same name, or a file is in the way.
    """
    pages = [page for name in names for page in _pages_of(store.expanded(name))]
    folder, ending, stems = _file_names(pages, out, spec.ending)
    endings = [ending, _PREVIEW] if spec.preview else [ending]
    _refuse_pictures(
        [path for path, _ in pages], Path(folder), [stem + suffix for stem in stems for suffix in endings]
    )
    products = [
        printing.Product(
            stem,
            tuple(glob.escape(stem) + suffix for suffix in endings),
            partial(_made, path, page, stem, ending, spec),
        )
        for stem, (path, page) in zip(stems, pages, strict=True)
    ]
    workers = min(workers, len(products))
    return printing.FileExport.of(
        products, folder, overwrite=overwrite, dry_run=dry_run, workers=workers, on_progress=on_progress
    )


def _refuse_pictures(pictures: Sequence[Path], folder: Path, names: Sequence[str]) -> None:
    """Refuse to replace a picture by a file that is made from it."""
    targets = {(folder / name).resolve() for name in names}
    hit = next((path for path in pictures if path.resolve() in targets), None)
    if hit is not None:
        raise InputError(f"{str(hit)!r} is a picture and would be replaced", next="choose another --out")


def _pages_of(path: Path) -> Iterator[tuple[Path, int]]:
    files = [path]
    if path.is_dir():
        files = store.list_files(path)
        others = [inner.name for inner in files if not is_picture_name(inner.name)]
        if others or not files:
            what = f"it holds {others[0]!r}" if others else "it is empty"
            raise InputError(
                f"{path}: {what}; expected pictures only", next="name the pictures, or move other files away"
            )
    elif not path.is_file():
        raise InputError(f"{path}: there is no such file; expected a picture", next="check the path")
    for file in files:
        try:
            pages = pages_of(file)
        except ItemError:
            pages = (0,)  # the reason is stated when it is read
        for page in pages:
            yield file, page


def _file_names(pages: Sequence[tuple[Path, int]], out: str, ending: str) -> tuple[str, str, Sequence[str]]:
    """Return the folder, the ending, and the names of the files without their ending."""
    target = store.expanded(out)
    if target.suffix.lower() in mesh.MeshFile.FORMATS:
        if len(pages) != 1:
            raise InputError(
                f"is the file {out!r}, but {_counted(pages)}",
                next="give a folder, and the format by --format",
                field="out",
            )
        return str(target.parent), target.suffix.lower(), [target.stem]
    if target.suffix:
        raise InputError(
            f"is {out!r}; expected a folder, or a file that ends in {', '.join(mesh.MeshFile.FORMATS)}",
            next="change its ending",
            field="out",
        )
    paged = {path for path, page in pages if page}
    stems = [f"{path.stem}-{page + 1}" if path in paged else path.stem for path, page in pages]
    folded = [stem.casefold() for stem in stems]
    twice = next((stem for stem, key in zip(stems, folded, strict=True) if folded.count(key) > 1), None)
    if twice is not None:
        raise InputError(
            f"two pictures would make {twice + ending!r}", next="rename one, or make them in two commands"
        )
    return str(target), ending, stems


def _counted(pages: Sequence[tuple[Path, int]]) -> str:
    """Return the number of pictures, or of pages of one file, as text."""
    files = {path for path, _ in pages}
    if len(files) > 1 or pages[-1][1] == 0:
        return f"there are {len(pages):,} pictures"
    return f"{pages[0][0]} has {len(pages):,} pages, each of which is a picture"


def _made(path: Path, page: int, stem: str, ending: str, spec: PrintSpec) -> printing.Made[PrintedPicture]:
    """Make the file of a picture, and its preview; ItemError if the picture cannot be used."""
    sized = picture_ink.sized_ink(
        str(path), None, spec.size, changes=spec.changes, which=spec.ink, threshold=spec.threshold, page=page
    )
    part = algorithm.solid_of_ink(sized, spec.base_mm).on_plate()
    report = mesh.PrintReport.of(part, spec.profile).require_solid()
    notes = sized.notes
    if spec.base_mm is not None:
        width, depth = (side - 2 * mesh.BASE_MARGIN_MM for side in report.size_mm[:2])
        notes = (*notes, f"the drawing is {width:.1f} x {depth:.1f} mm, and its base plate is larger")
    if report.faces > _MANY_TRIANGLES:
        fewer = f"--vertices {_MANY_TRIANGLES // 4} makes fewer"
        notes = (*notes, f"it has {report.faces:,} triangles, which slow slicers down; {fewer}")

    def record(_volume_mm3: float, size: int, state: str) -> PrintedPicture:
        return PrintedPicture(str(path), f"{stem}{ending}", report, notes, size, state)

    beside = {}
    if spec.preview:
        beside[f"{stem}{_PREVIEW}"] = _drawn(path.name, sized.mask, part, report)
    return printing.Made.of_solid(stem, ending, part, record, beside, report)


def _drawn(name: str, mask: Bool, part: mesh.Mesh, report: mesh.PrintReport) -> bytes:
    """Draw the ink as it was found, and the solid, as PNG."""
    sides_m = np.ptp(part.vertices_m, axis=0)
    px_per_m = 0.9 * min(_VIEW_PX[0] / (sides_m[0] + sides_m[2]), _VIEW_PX[1] / (sides_m[1] + sides_m[2]))
    view = pictures.View.OBLIQUE.draw(((part, CLAY),), _VIEW_PX, px_per_m)
    width, depth, height = report.size_mm
    words = f"{width:.1f} x {depth:.1f} x {height:.1f} mm, {report.volume_mm3:,.0f} mm³"
    drawn = pictures.sheet(
        (pictures.Tile(_fitted(mask), "ink as it was found"), pictures.Tile(view, "the solid")),
        2,
        name,
        (words,),
    )
    return touch.encode_image(drawn, "png")


def _fitted(mask: Bool) -> UInt8:
    """Draw a mask as a picture of the height of the view."""
    rows, columns = np.flatnonzero(mask.any(axis=1)), np.flatnonzero(mask.any(axis=0))
    cut = mask[rows[0] : rows[-1] + 1, columns[0] : columns[-1] + 1]
    step = max(1, -(-max(cut.shape[0] * _VIEW_PX[0] // _VIEW_PX[1], cut.shape[1]) // _VIEW_PX[0]))
    # Thin lines become grey instead of being skipped.
    levels = Image.fromarray(np.where(cut, 0, 255).astype(np.uint8)).reduce(step)
    return np.asarray(levels.convert("RGB"))
