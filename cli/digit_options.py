"""Groups of options of ``mnist3d generate``, and what they describe."""

from __future__ import annotations

from dataclasses import dataclass, fields
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import typer

from cli.options import Limit, Seed, is_count

if TYPE_CHECKING:
    from mnist3d.solid import SolidSpec
    from mnist3d.sources import DigitSource
    from mnist3d.splits import SplitSpec

__all__ = ["DigitSplit", "DivisionOptions", "SolidOptions", "SourceOptions"]

DigitSplit = Literal["train", "test", "holdout", "printed_train", "printed_test", "all"]
SourceName = Literal["synthetic", "hwdplus", "mnist", "folder"]

_SOURCES_OF: dict[str, tuple[SourceName, ...]] = {
    "images": ("hwdplus", "mnist", "folder"),
    "writer_info": ("hwdplus",),
    "writer_column": ("hwdplus",),
    "download": ("mnist",),
    "ink": ("folder",),
    "digits": ("synthetic",),
}
_SYNTHETIC_DIGITS = 13_580
"""As many as MNIST 3D has (Tactile MNIST paper)."""


@dataclass(frozen=True, slots=True)
class SourceOptions:
    """Where the images come from; an option that was not given is None or False."""

    # Defaults stand in `show_default` where None has to say that nothing was given: an option of another
    # source is refused even with the value that is its default.
    source: Annotated[SourceName, typer.Option(help="Where the images come from.")] = "synthetic"
    images: Annotated[
        Path | None,
        typer.Option(
            metavar="PATH",
            help="Images of the source: the .npy file of HWD+, the folder of the MNIST files, or a folder of "
            "pictures DIR/<label>/*.png.",
        ),
    ] = None
    writer_info: Annotated[
        Path | None, typer.Option(metavar="FILE", help="WriterInfo.npy of HWD+ (column 0 is the label).")
    ] = None
    writer_column: Annotated[
        int | None, typer.Option(min=0, metavar="N", help="Column of WriterInfo.npy that holds the writer.")
    ] = None
    download: Annotated[
        bool, typer.Option("--download", help="Fetch MNIST into --images first (extra `torch`).")
    ] = False
    ink: Annotated[
        Literal["auto", "dark", "light"] | None,
        typer.Option(help="Ink of pictures in a folder.", show_default="auto"),
    ] = None
    digits: Annotated[
        int | None,
        typer.Option(
            min=1,
            metavar="N",
            help="How many digits the synthetic source holds.",
            show_default=str(_SYNTHETIC_DIGITS),
        ),
    ] = None

    def build(self, seed: int) -> DigitSource:
        """Make the source. Raises InputError for options that are missing or of another source."""
        from tactile_toolkit.errors import InputError

        self._refuse_foreign()
        if self.source == "synthetic":
            from mnist3d.sources.synthetic import SyntheticSource

            return SyntheticSource(seed=seed, count=self.digits or _SYNTHETIC_DIGITS)
        if self.images is None:
            message = (
                f"--source {self.source} needs --images PATH, which was not given; see mnist3d generate "
                "--help"
            )
            raise InputError(message)
        images = str(self.images)
        if self.source == "hwdplus":
            from mnist3d.sources.hwdplus import HwdPlusSource

            if self.writer_info is None:
                message = "--source hwdplus needs --writer-info FILE (WriterInfo.npy), which was not given"
                raise InputError(message)
            return HwdPlusSource(images, str(self.writer_info), self.writer_column)
        if self.source == "mnist":
            from mnist3d.sources.mnist import MnistSource, download_mnist

            if self.download:
                download_mnist(images)
            return MnistSource(images)
        from mnist3d.sources.folder import FolderSource

        return FolderSource(images, ink=self.ink or "auto")

    def _refuse_foreign(self) -> None:
        """Refuse options of other sources, which would make another data set than was meant."""
        from tactile_toolkit.errors import InputError

        for field in fields(self)[1:]:
            value, sources = getattr(self, field.name), _SOURCES_OF[field.name]
            if value is not None and value is not False and self.source not in sources:
                option = f"--{field.name.replace('_', '-')}"
                message = (
                    f"{option} does not belong to --source {self.source}; next: leave it out, or name its "
                    f"source (--source {' or '.join(sources)})"
                )
                raise InputError(message)


@dataclass(frozen=True, slots=True)
class DivisionOptions:
    """Which digits go into which split, and how many of them are made."""

    seed: Seed = 0
    split_by: Annotated[
        Literal["digit", "writer", "none"] | None,
        typer.Option(
            help="Divide single digits, whole writers, or nothing: then all are in train.",
            show_default="digit",
        ),
    ] = None
    split_sizes: Annotated[
        str | None,
        typer.Option(
            metavar="train=8,test=2", help="Digits per class in each split instead of the published."
        ),
    ] = None
    per_class: Annotated[
        int | None, typer.Option(min=1, metavar="N", help="Only the first N digits of each class of a split.")
    ] = None
    limit: Limit = None

    def spec(self) -> SplitSpec:
        """Return the division. Raises InputError for sizes that cannot be read."""
        from mnist3d.splits import SplitSpec
        from tactile_toolkit.errors import InputError

        if self.split_sizes is None:
            return SplitSpec(self.seed, self.split_by)
        sizes: dict[str, int] = {}
        for part in self.split_sizes.split(","):
            split, _, size = part.strip().partition("=")
            if not is_count(size.strip()) or split in sizes:
                message = (
                    f"--split-sizes has {part!r}; expected SPLIT=N once per split, such as train=8,test=2"
                )
                raise InputError(message)
            sizes[split] = int(size)
        return SplitSpec(self.seed, self.split_by, tuple(sizes.items()))


@dataclass(frozen=True, slots=True)
class SolidOptions:
    """How an image becomes a solid."""

    profile: Annotated[
        Literal["round", "linear", "flat"], typer.Option(help="How the rim of a digit rises.")
    ] = "round"
    erosion: Annotated[
        Literal["outline", "disc"],
        typer.Option(help="Draw the outline in by each radius, or erode with a disc of pixels."),
    ] = "outline"
    half_thickness_mm: Annotated[
        float, typer.Option(help="Height above the mid-plane of ink that is wide enough.")
    ] = 4.0
    target_vertices: Annotated[
        int,
        typer.Option("--vertices", metavar="N", help="Vertices of a mesh, about; 1.5 times as many at most."),
    ] = 5_000
    join_bodies: Annotated[
        bool, typer.Option("--join-bodies", help="Bridge separate pieces so that a digit prints in one.")
    ] = False

    def spec(self) -> SolidSpec:
        """Return the specification of solids."""
        from mnist3d.solid import SolidSpec

        # Fields are named as those of `SolidSpec`; here so that --help imports no numpy.
        return SolidSpec(**{field.name: getattr(self, field.name) for field in fields(self)})
