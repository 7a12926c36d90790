"""Commands that convert data sets of touches to other data sets or files."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import MISSING, dataclass, fields, replace
from functools import partial

import typer

from cli import application, declared_options, output, runs
from cli.options import TOUCH_SET, Opening, Work, out_folder
from realtouch.kind import KIND
from tactile_toolkit import catalog, checked_fields, places, store, touch
from tactile_toolkit.errors import InputError

_FRAME = checked_fields.choice(
    "contact_end",
    ("contact_end", "contact_start", "peak", "best"),
    help="Frame of a clip: end or start of the contact, the deepest press, or the highest contact score.",
)


@dataclass(frozen=True, slots=True)
class _Options:
    """Options of a conversion."""

    def arguments(self) -> declared_options.Given:
        """Return the arguments of the conversion."""
        return {each.name: getattr(self, each.name) for each in fields(self)}


@dataclass(frozen=True, slots=True)
class ClipsToImages(_Options):
    """Make a data set of single images from one of clips: a frame of each clip, with its pose.

    Example: realtouch clips-to-images real-seq --frame peak --out touches
    """

    frame: str = _FRAME


@dataclass(frozen=True, slots=True)
class Resize(_Options):
    """Write the same data set with images or clips of another size.

    Example: realtouch resize real-single-320x240 --size 64x64 --out small
    """

    size: tuple[int, int] = touch.size_option(MISSING)
    quality: int = checked_fields.integer(
        95, 1, 100, help="JPEG quality of images that are encoded again, 1 to 100."
    )

    def arguments(self) -> declared_options.Given:
        """Return the arguments of the conversion; width and height are separate."""
        width, height = self.size
        return {"width": width, "height": height, "quality": self.quality}


@dataclass(frozen=True, slots=True)
class Depth(_Options):
    """Write the same data set with depth maps in metres, as the twin of the sensor reads them.

    Each pixel has an expected error.

    Example: realtouch depth recordings --sensor my-sensor --out depths
    """

    sensor: str = checked_fields.text(
        MISSING, metavar="MODEL", help="Folder that `tactile-sim calibrate` wrote."
    )
    fast: bool = checked_fields.switch(
        False, help="Use a faster method, with about twice the error and a tenth of the time."
    )


@dataclass(frozen=True, slots=True)
class Frames(_Options):
    """Write touches as plain image files with an index in CSV and Parquet.

    Example: realtouch frames real-single-64x64 --format jpeg --out pictures

    Example: realtouch frames real-seq --frame best --difference grey --out changes
    """

    kind: str = checked_fields.choice(
        "png",
        ("png", "jpeg"),
        name="--format",
        help="png: exact pixels; jpeg: the stored JPEGs, unchanged.",
    )
    frame: str = _FRAME
    difference: str | None = checked_fields.choice(
        None,
        ("grey", "absolute"),
        optional=True,
        help="Write the difference from the median of the clip or round: grey (128 means no change) or "
        "absolute.",
    )


@dataclass(frozen=True, slots=True)
class Select(_Options):
    """Write selected rounds and touches of a data set; images are copied byte for byte.

    Example: realtouch select real-single-64x64 --contact --labels 3,5 --out touched
    """

    contact: bool = checked_fields.switch(False, help="Only touches in contact with an object.")
    min_height_mm: float | None = touch.contact_height_option()
    recalibrate_z: bool = checked_fields.switch(
        True,
        name="--recalibrate/--as-recorded",
        help="If the height of the plate is unknown, use the deepest touch of each round.",
    )
    ids: catalog.IdChoice | None = catalog.IDS
    labels: tuple[str, ...] | None = catalog.LABELS
    per_class: int | None = catalog.PER_CLASS

    def arguments(self) -> declared_options.Given:
        """Return the arguments of the conversion; InputError for options that would have no effect."""
        if not self.contact and (self.min_height_mm is not None or not self.recalibrate_z):
            raise InputError("--min-height-mm and --as-recorded need --contact", next="add --contact")
        # Ids of objects are numbers.
        objects = [each if isinstance(each, int) else catalog.id_range(each) for each in self.ids or ()]
        min_height_m = None
        if self.min_height_mm is not None:
            min_height_m = self.min_height_mm / 1000
        return {
            "contact": self.contact,
            "min_height_m": min_height_m,
            "recalibrate_z": self.recalibrate_z,
            "objects": objects,
            "labels": self.labels or (),
            "per_class": self.per_class,
        }


@dataclass(frozen=True, slots=True)
class Export(_Options):
    """Write touches for other libraries; stored JPEGs are copied, never encoded again.

    Example: realtouch export real-single-64x64 --split train --format flat --out flat

    Example: realtouch export real-seq --split train --format lerobot --out robots
    """

    layout: str = checked_fields.choice(
        MISSING,
        ("flat", "webdataset", "lerobot", "oxt", "replay", "fota", "anytouch"),
        name="--format",
        help="flat: Parquet, a row for each touch; webdataset: tars; lerobot: LeRobotDataset v3.0; oxt: Zarr "
        "of FTP-1; replay: Zarr of Diffusion Policy; fota: tars of T3; anytouch: list "
        "files. lerobot, oxt and replay hold one split.",
    )
    frame: str = _FRAME


def add_conversion(
    app: typer.Typer,
    name: str,
    options_of: type,
    function: Callable[..., store.Manifest],
    nouns: str = KIND.nouns,
) -> None:
    """Add a command: print what will be fetched, convert with progress, print what was made.

    ``options_of`` is the class of its options. They have the names of parameters of ``function``, unless the
    method ``arguments`` is overridden. Its docstring is the help. ``nouns`` names the rows of the result.
    """

    def convert(
        *,
        source: str = TOUCH_SET,
        opening: Opening,
        out: str = out_folder(),
        options: _Options,
        split: str | None = catalog.SPLIT,
        limit: int | None = catalog.LIMIT,
        work: Work,
        sink: output.Sink,
    ) -> None:
        opened = opening.open(sink, source).require(KIND, name)
        make = partial(function, opened, out, **options.arguments(), split=split, limit=limit)
        announce_fetching(sink, opened, split)
        kind = replace(KIND, nouns=nouns)
        runs.make_with_progress(sink, "converting", kind, make, work, out, runs.print_set, KIND.nouns)

    convert.__doc__ = options_of.__doc__
    convert.__annotations__["options"] = options_of
    application.command(app, name)(convert)


def announce_fetching(sink: output.Sink, place: places.Place, split: str | None) -> None:
    """Print which splits will be fetched from the Hub, as published data sets have many gigabytes."""
    if place.repository is None:
        return
    part = "all splits (--split selects one)"
    if split:
        part = f"split {split!r}"
    sink.info(f"{place.repository.repo_id}: fetching the missing files of {part} from the Hub")
