"""Where images come from, as commands have options of it."""

from __future__ import annotations

from dataclasses import dataclass

from mnist3d.published_splits import MOST_DIGITS
from tactile_toolkit.checked_fields import (
    choice,
    integer,
    switch,
    text,
)

SOURCES = ("synthetic", "hwdplus", "mnist", "folder")


@dataclass(frozen=True, slots=True)
class SourceOptions:
    """Where the images come from."""

    images: str | None = text(
        metavar="PATH",
        help="Images of the source: the .npy file of HWD+, the folder of the MNIST files, or a folder of "
        "pictures DIR/<label>/*.png.",
    )
    writer_info: str | None = text(metavar="FILE", help="WriterInfo.npy of HWD+ (column 0 is the label).")
    writer_column: int | None = integer(None, help="Column of WriterInfo.npy that holds the writer.")
    download: bool = switch(False, help="Fetch MNIST into --images first (extra `torch`).")
    foreground: str = choice(
        "auto",
        ("auto", "dark", "light"),
        help="Strokes of the images in a folder: darker than the paper, or lighter.",
    )
    threshold: str = choice(
        "auto",
        ("auto", "local", "global"),
        help="Even out the light of pictures and look for the page (local), or take one grey level for all "
        "of a picture (global); auto evens out what has no clean paper.",
    )
    # As many as MNIST 3D has (Tactile MNIST paper).
    digits: int = integer(13_580, 1, MOST_DIGITS, help="Number of digits in the synthetic source.")
