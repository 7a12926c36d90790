"""``mnist3d``: make, check and look into data sets of printable 3D digits."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING, Annotated, Any

from cli.application import OptionsOf, command, new_app, run
from cli.export_commands import add_export
from cli.folders import Geometry, add_info, add_verify, least_to_most, print_made, print_skipped
from cli.gallery_commands import add_mesh_gallery
from cli.hub_upload import add_hub_commands
from cli.making import generate_set
from cli.options import Limit, Making, Out, PerClass
from cli.output import Sink, bytes_text
from cli.preview_commands import preview_digits
from mnist3d.kind import KIND
from mnist3d.spec import SPLITS, SolidSpec, SplitSpec
from tactile_toolkit.checked_fields import choice, integer, switch, text
from tactile_toolkit.errors import InputError
from tactile_toolkit.kind import lazy

if TYPE_CHECKING:
    from mnist3d.sources import DigitSource
    from mnist3d.validate import Checked
    from tactile_toolkit.store.manifest import Manifest

__all__ = ["app", "main"]

app = new_app("mnist3d", "Printable 3D digits: from images of handwriting to validated data sets of meshes.")

_SOURCES_OF = {
    "images": ("hwdplus", "mnist", "folder"),
    "writer_info": ("hwdplus",),
    "writer_column": ("hwdplus",),
    "download": ("mnist",),
    "ink": ("folder",),
    "digits": ("synthetic",),
}
"""The sources that each option belongs to."""


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
    ink: str = choice("auto", ("auto", "dark", "light"), help="Ink of pictures in a folder.")
    # As many as MNIST 3D has (Tactile MNIST paper).
    digits: int = integer(13_580, 1, help="How many digits the synthetic source holds.")


def _source(name: str, given: Mapping[str, Any], seed: int) -> DigitSource:
    """Return the source; InputError for options that are missing or of another source."""
    for option in given:
        if name not in _SOURCES_OF[option]:
            owners = " or ".join(_SOURCES_OF[option])
            message = (
                f"--{option.replace('_', '-')} does not belong to --source {name}; next: leave it out, or "
                f"name its source (--source {owners})"
            )
            raise InputError(message)
    needed = {"hwdplus": ("images", "writer_info"), "mnist": ("images",), "folder": ("images",)}
    for option in needed.get(name, ()):
        if option not in given:
            message = (
                f"--source {name} needs --{option.replace('_', '-')}, which was not given; see mnist3d "
                "generate --help"
            )
            raise InputError(message)
    if name == "hwdplus":
        from mnist3d.sources.hwdplus import HwdPlusSource

        return HwdPlusSource(**given)
    if name == "mnist":
        from mnist3d.sources.mnist import MnistSource, download_mnist

        if given.get("download"):
            download_mnist(given["images"])
        return MnistSource(given["images"])
    if name == "folder":
        from mnist3d.sources.folder import FolderSource

        return FolderSource(given["images"], ink=given.get("ink", "auto"))
    from mnist3d.sources.synthetic import SyntheticSource

    return SyntheticSource(seed=seed, count=given.get("digits", SourceOptions().digits))


@command(app)
def generate(
    *,
    split: str | None = choice(
        None,
        (*SPLITS, "all"),
        shown="all",
        help="Split to make. Without it, pictures of a folder are all in train.",
    ),
    out: Out = "mnist3d-data",
    source: str = choice(
        "synthetic", ("synthetic", "hwdplus", "mnist", "folder"), help="Where the images come from."
    ),
    images: Annotated[dict[str, Any], OptionsOf(SourceOptions)],
    division: SplitSpec,
    per_class: PerClass = None,
    limit: Limit = None,
    solid: SolidSpec,
    making: Making,
    sink: Sink,
) -> None:
    """Make a data set of printable 3D digits.

    Example: mnist3d generate --split train --per-class 10 --out digits

    A run that was stopped goes on when the same command is given again; finished shards are never made twice.
    """
    from mnist3d.generation import GenerateSpec, forecast
    from mnist3d.generation import generate as make
    from tactile_toolkit.run.limits import prepare_batch_process

    spec = GenerateSpec(
        source=_source(source, images, division.seed),
        solid=solid,
        split=division,
        per_class=per_class,
        limit=limit,
    )
    splits = None if split is None else SPLITS if split == "all" else (split,)
    # Before the first digit, of a forecast too: it measures what a worker takes.
    prepare_batch_process()
    generate_set(
        sink,
        KIND,
        making,
        out,
        splits,
        what="making digits",
        forecast=partial(forecast, spec, out, splits),
        make=partial(make, spec, out, splits),
        print_made=_print_made,
    )


def _print_made(sink: Sink, manifest: Manifest, out: str, elapsed_s: float | None) -> None:
    from mnist3d.summary import summarise
    from tactile_toolkit.store.folder import DataFolder

    # The report that the figures come from is written at the end of a run.
    summaries = summarise(DataFolder(out), manifest) if manifest.complete else []
    rows = [
        (
            summary.split,
            summary.rows,
            least_to_most(summary.per_class),
            bytes_text(summary.bytes),
            _range(summary.height_mm),
            _range(summary.thinnest_wall_mm),
            summary.skipped,
            ", ".join(f"{word} {count:,}" for word, count in summary.warnings.items()) or "none",
        )
        for summary in summaries
    ]
    measures = ("height mm", "thinnest wall mm", "skipped", "warnings")
    header = ("split", "digits", "per class", "Parquet", *measures)
    splits = [summary.to_dict() for summary in summaries] or manifest.split_table()
    skipped = manifest.skipped_reasons()
    print_made(sink, KIND, manifest, out, splits, elapsed_s, (header, rows), skipped=skipped)
    if manifest.complete:
        print_skipped(sink, manifest, out, KIND.nouns, "skipped")


def _range(spread: tuple[float, ...]) -> str:
    return f"{spread[0]:.1f}-{spread[-1]:.1f}" if spread else "-"


def _print_checked(sink: Sink, results: Sequence[Checked]) -> None:
    # Named even with --quiet: a mesh that could not be read has no row in any table.
    for item in (item for result in results for item in result.unreadable):
        sink.insist(f"unreadable: {item.report.detail}")
    for result in results:
        sink.table(*result.table())
    failed = sum(result.failed for result in results)
    checked = sum(result.checked for result in results)
    are = "mesh is a valid solid" if checked == 1 else "meshes are valid solids"
    sink.line(f"{checked - failed:,} of {checked:,} {are}")


_GEOMETRY = Geometry(
    "meshes",
    """Check meshes as read back from disk: whether each is a solid, and whether it will print.

    Example: mnist3d validate digits part.stl

    Exit code 1 when a mesh is not a valid solid. For a folder, `verify --geometry` checks its files as well.
    """,
    lazy("mnist3d.validate:validate_paths"),
    _print_checked,
)


add_info(app, KIND, _print_made, "source and spec")
add_verify(app, KIND, _GEOMETRY)
command(app, "preview")(preview_digits)
add_hub_commands(app, KIND)
add_mesh_gallery(app, KIND)
add_export(app, KIND)


def main() -> None:
    """Run the command line."""
    run(app)
