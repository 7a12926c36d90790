"""Which pictures of digits to draw."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from tactile_toolkit import catalog, mesh
from tactile_toolkit.checked_fields import (
    choice,
    text,
)


@dataclass(frozen=True, slots=True)
class DigitPreviewSpec(catalog.PreviewSpec):
    """Which pictures of digits to draw; the steps need the files that the images came from."""

    kinds: tuple[str, ...] = choice(
        (),
        ("sheet", "steps", "all"),
        name="--kind",
        help="What to draw; may be repeated. Of a data set: sheet.",
    )
    images: Path | None = text(
        metavar="PATH",
        read=Path,
        help="Images that the data set was made from, as for `generate`; for --kind steps.",
    )
    writer_info: Path | None = text(
        metavar="FILE", read=Path, help="WriterInfo.npy of HWD+; for --kind steps."
    )
    unit: str | None = mesh.UNIT
