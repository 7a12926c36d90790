"""``mnist3d``: make, check and look into data sets of printable 3D digits."""

from __future__ import annotations

from functools import partial
from typing import TYPE_CHECKING, Annotated

import typer

from cli.application import EXIT_FAILED, command, new_app, run
from cli.copies import manifest_or_copy
from cli.digit_options import DigitSplit, DivisionOptions, SolidOptions, SourceOptions
from cli.export_commands import add_export
from cli.folders import add_verify, least_to_most, print_made, print_spec
from cli.gallery_commands import add_mesh_gallery
from cli.hub_upload import add_hub_commands
from cli.making import make_with_progress, print_conclusion, print_forecast
from cli.options import Folder, Json, Limit, Making, Out, Workers, place_of_data, process_count
from cli.output import Sink, bytes_text, counted
from cli.preview_commands import preview_digits
from cli.touch_tables import print_converted
from mnist3d.kind import KIND
from tactile_toolkit.kind import is_export

if TYPE_CHECKING:
    from tactile_toolkit.store.manifest import Manifest

__all__ = ["app", "main"]

app = new_app("mnist3d", "Printable 3D digits: from images of handwriting to validated data sets of meshes.")


@command(app)
def generate(
    *,
    split: Annotated[
        DigitSplit | None,
        typer.Option(
            help="Split to make. Without it, pictures of a folder are all in train.", show_default="all"
        ),
    ] = None,
    out: Out = "mnist3d-data",
    source: SourceOptions,
    division: DivisionOptions,
    solid: SolidOptions,
    making: Making,
    sink: Sink,
) -> None:
    """Make a data set of printable 3D digits.

    Example: mnist3d generate --split train --per-class 10 --out digits

    A run that was stopped goes on when the same command is given again; finished shards are never made twice.
    """
    from mnist3d.generation import GenerateSpec, forecast
    from mnist3d.generation import generate as make
    from mnist3d.splits import SPLITS
    from tactile_toolkit.run.limits import prepare_batch_process

    spec = GenerateSpec(
        source=source.build(division.seed),
        solid=solid.spec(),
        split=division.spec(),
        per_class=division.per_class,
        limit=division.limit,
    )
    splits = None if split is None else SPLITS if split == "all" else (split,)
    # Before the first digit, of a forecast too: it measures what a worker takes.
    prepare_batch_process()
    if making.dry_run:
        view = forecast(spec, out, splits, making.chosen_runner(), overwrite=making.overwrite)
        print_forecast(sink, KIND, view, out, making)
        return
    made = make_with_progress(
        sink, "making digits", KIND.nouns, partial(make, spec, out, splits), making, out
    )
    if made is not None:
        _print_made(sink, made.manifest, out, made.elapsed_s)
        print_conclusion(sink, KIND, made, out, splits or SPLITS)


@command(app)
def validate(
    *,
    paths: Annotated[
        list[str],
        typer.Argument(
            parser=place_of_data,
            metavar="DIR|FILE...",
            help="Data set folders, or STL/3MF/PLY/OBJ/GLB files.",
        ),
    ],
    split: Annotated[DigitSplit, typer.Option(help="Split of a data set folder.")] = "all",
    limit: Limit = None,
    workers: Workers = 1,
    sink: Sink,
) -> None:
    """Check meshes as read back from disk: whether each is a solid, and whether it will print.

    Example: mnist3d validate digits part.stl

    Exit code 1 when a mesh is not a valid solid.
    """
    from mnist3d.validate import validate_paths
    from tactile_toolkit.run.limits import prepare_batch_process

    prepare_batch_process()
    chosen = None if split == "all" else split
    with sink.progress("checking", "meshes") as update:
        results = validate_paths(paths, chosen, limit, process_count(workers), on_progress=update)
    sink.document([result.to_dict() for result in results])
    # Named even with --quiet: a mesh that could not be read has no row in any table.
    for item in (item for result in results for item in result.unreadable):
        sink.insist(f"unreadable: {item.report.detail}")
    for result in results:
        sink.table(*result.table())
    failed = sum(result.failed for result in results)
    checked = sum(result.checked for result in results)
    are = "mesh is a valid solid" if checked == 1 else "meshes are valid solids"
    sink.line(f"{checked - failed:,} of {checked:,} {are}")
    if failed:
        raise typer.Exit(EXIT_FAILED)


@command(app)
def info(folder: Folder, as_json: Json = False) -> None:
    """Show what a data set folder holds and how it was made."""
    sink = Sink(as_json)
    manifest = manifest_or_copy(sink, KIND, folder)
    if manifest is not None and is_export(manifest):
        print_converted(sink, manifest, folder, KIND.nouns)
    elif manifest is not None:
        _print_made(sink, manifest, folder)
        print_spec(sink, manifest, "source and spec")


def _print_made(sink: Sink, manifest: Manifest, out: str, elapsed_s: float | None = None) -> None:
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
        for reason, count in skipped.items():
            sink.line(f"skipped {counted(count, 'digits')}: {reason} (each is named in {out}/manifest.json)")


def _range(spread: tuple[float, ...]) -> str:
    return f"{spread[0]:.1f}-{spread[-1]:.1f}" if spread else "-"


add_verify(app, KIND, "a data set folder")
command(app, "preview")(preview_digits)
add_hub_commands(app, KIND)
add_mesh_gallery(app, KIND)
add_export(app, KIND)


def main() -> None:
    """Run the command line."""
    run(app)
