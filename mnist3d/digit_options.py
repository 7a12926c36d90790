"""Options of commands for digits: source of images, and previews."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from mnist3d.published_splits import MAX_DIGITS
from tactile_toolkit import catalog, checked_fields, mesh

SOURCES = ("synthetic", "hwdplus", "mnist", "folder")


@dataclass(frozen=True, slots=True)
class SourceOptions:
    """Options of the source of images."""

    images: str | None = checked_fields.text(
        metavar="PATH",
        help="Images of the source: the .npy file of HWD+, the folder of the MNIST files, or a folder of "
        "pictures DIR/<class>/*.png.",
    )
    writer_info: str | None = checked_fields.text(
        metavar="FILE", help="WriterInfo.npy of HWD+ (column 0 is the label)."
    )
    writer_column: int | None = checked_fields.integer(
        None, help="Column of WriterInfo.npy that holds the writer."
    )
    download: bool = checked_fields.switch(False, help="Download MNIST into --images first (extra `torch`).")
    foreground: str = checked_fields.choice(
        "auto",
        ("auto", "dark", "light"),
        help="Whether the strokes in images of a folder are darker or lighter than the paper.",
    )
    threshold: str = checked_fields.choice(
        "auto",
        ("auto", "local", "global"),
        help="Even out the light and find the page (local), or apply one threshold (global); auto takes "
        "local for pictures without clean paper.",
    )
    # As many as MNIST 3D has (Tactile MNIST paper).
    digits: int = checked_fields.integer(
        13_580, 1, MAX_DIGITS, help="Number of digits in the synthetic source."
    )


@dataclass(frozen=True, slots=True)
class DigitPreviewSpec(catalog.PreviewSpec):
    """Options of previews of digits; the steps for a data set need the files of its source."""

    kinds: tuple[str, ...] = checked_fields.choice(
        (),
        ("sheet", "steps", "all"),
        name="--kind",
        help="What to draw; may be repeated. By default sheet, or steps for a picture.",
    )
    images: Path | None = checked_fields.text(
        metavar="PATH",
        read=Path,
        help="Images of the source of the data set, as given to `generate`; for --kind steps.",
    )
    writer_info: Path | None = checked_fields.text(
        metavar="FILE", read=Path, help="WriterInfo.npy of HWD+; for --kind steps."
    )
    unit: str | None = mesh.UNIT
