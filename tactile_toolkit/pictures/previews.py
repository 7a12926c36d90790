"""Previews in files: pictures of chosen rows, planned first, then drawn one by one."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from tactile_toolkit import catalog, places, store, touch
from tactile_toolkit.errors import InputError
from tactile_toolkit.kind import DatasetKind
from tactile_toolkit.pictures.solid_views import solid_sheet
from tactile_toolkit.value_types import UInt8
from tactile_toolkit.wording import with_count

_TILE_PX = 140  # of the largest object of a sheet


@dataclass(frozen=True, slots=True)
class PictureTask:
    """A picture that is not drawn yet: its file name (``.png``) and a short description."""

    name: str
    what: str
    draw: Callable[[], UInt8]

    @staticmethod
    def stem_of(name: str) -> str:
        """Return the beginning of the names of pictures of a data set: the end of its path, made safe."""
        path = store.expanded(name)
        last = path.name
        if path.is_dir():
            last = path.resolve().name
        elif path.is_file():
            last = path.stem
        plain = "".join(letter if letter.isalnum() or letter in "-_." else "-" for letter in last)
        # A leading dot would hide the file, and a leading dash make it an option.
        return plain.strip("-.") or "pictures"


@dataclass(frozen=True, slots=True)
class PicturePlan:
    """The pictures to draw, in order, and why some kinds are left out."""

    pictures: tuple[PictureTask, ...]
    left_out: tuple[str, ...] = ()

    @classmethod
    def of_kinds(
        cls, asked: Sequence[str], plans: Mapping[str, Callable[[], Sequence[PictureTask]]]
    ) -> PicturePlan:
        """Plan the pictures of each requested kind, or of the first one.

        ``"all"`` stands for all kinds. Kinds that cannot be drawn are left out with the reason, unless they
        were named. Raises InputError for an unknown kind, for a named kind that cannot be drawn, and where no
        kind can be drawn.
        """
        unknown = [kind for kind in asked if kind not in (*plans, "all")]
        if unknown:
            raise InputError(f"no pictures of kind {unknown[0]!r}; expected {', '.join(plans)} or all")
        named = bool(asked) and "all" not in asked
        chosen = plans if "all" in asked else asked or next(iter(plans))
        pictures: list[PictureTask] = []
        reasons: list[InputError] = []
        for kind in filter(chosen.__contains__, plans):
            try:
                pictures += plans[kind]()
            except InputError as error:
                if named:
                    raise
                reasons.append(error)
        if not pictures and reasons:
            raise reasons[0]
        # Several kinds may need the same missing package.
        return cls(tuple(pictures), tuple(dict.fromkeys(str(reason) for reason in reasons)))

    def write(
        self,
        out: str | Path,
        *,
        overwrite: bool = False,
        on_progress: Callable[[int, int], None] = lambda _done, _all: None,
    ) -> list[WrittenPicture]:
        """Draw and write the pictures into a local folder.

        Each is written completely or not at all. If one fails, those before it are kept. Raises InputError,
        before any is drawn, if there are files of the same names; ``overwrite`` replaces them.
        """
        output = store.open_output(out, [picture.name for picture in self.pictures], overwrite=overwrite)
        written = []
        for done, picture in enumerate(self.pictures, start=1):
            pixels = picture.draw()
            content = touch.encode_image(pixels, "png")
            output.folder.write_bytes(picture.name, content)
            height, width = pixels.shape[:2]
            written.append(WrittenPicture(picture.name, picture.what, width, height, len(content)))
            on_progress(done, len(self.pictures))
        return written


@dataclass(frozen=True, slots=True)
class WrittenPicture:
    """A picture on disk: name and description as planned, size in pixels and bytes."""

    file: str
    what: str
    width: int
    height: int
    bytes: int


@dataclass(frozen=True)
class ChosenRows:
    """Rows of a data set to draw, by split."""

    place: places.Place
    kind: DatasetKind
    splits: Mapping[str, Any]  # data sets, which hold the chosen rows only

    @classmethod
    def of(
        cls, kind: DatasetKind, name: places.Name | places.Place, chosen: catalog.RowFilter, command: str
    ) -> ChosenRows:
        """Open a data set for a command and choose rows.

        Raises InputError if the data set, a split or an id does not exist, a split is empty, or the data have
        another kind; IntegrityError for a damaged or unfinished one.
        """
        source = places.open_place(name).require(kind, command)
        among = chosen.given()
        if isinstance(chosen, catalog.PreviewSpec) and chosen.ids:
            among.pop("per_class")  # it has a default, which must not hide ids that were asked for
        picked = catalog.RowFilter(**among).open(source, kind)
        return cls(source, kind, {split: dataset[rows] for split, dataset, rows in picked})

    @property
    def stem(self) -> str:
        """Beginning of the names of pictures."""
        return PictureTask.stem_of(self.place.name)

    def titled(self, title: str) -> str:
        """Return a title, with a note about unfinished data."""
        if not self.place.unfinished:
            return title
        return f"{title} (unfinished, {self.place.unfinished})"

    def plan_sheets(self, per_row: int) -> list[PictureTask]:
        """Plan a sheet of solids for each split, its rows sorted by class."""
        sheets = []
        for split, dataset in self.splits.items():
            rows = dataset[np.argsort(dataset.labels, kind="stable")]
            if len(rows):
                draw = partial(
                    _draw_rows, rows, per_row, self.titled(f"{self.stem}: {split}"), self.kind.nouns
                )
                what = f"{with_count(len(rows), self.kind.nouns)} of {split} from above"
                sheets.append(PictureTask(f"{self.stem}-{split}-sheet.png", what, draw))
        return sheets


def _draw_rows(rows: Any, per_row: int, title: str, nouns: str) -> UInt8:
    return solid_sheet(list(rows), _TILE_PX, per_row, title, rows.label_names, nouns)


def plan_sheets(
    kind: DatasetKind, name: places.Name | places.Place, spec: catalog.PreviewSpec
) -> PicturePlan:
    """Plan sheets of solids of a data set; nothing is drawn yet. Raises as :meth:`ChosenRows.of`."""
    rows = ChosenRows.of(kind, name, spec, "tactile preview")
    return PicturePlan.of_kinds(spec.kinds, {"sheet": partial(rows.plan_sheets, spec.per_class)})
