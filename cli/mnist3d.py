"""``mnist3d``: make, check and look into data sets of printable 3D digits."""

from __future__ import annotations

import os
import sys
from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from cli.application import new_app, run
from cli.card_commands import add_card
from cli.copies import print_copy
from cli.digit_source import SYNTHETIC_DIGITS, InkName, SourceName, digit_source
from cli.digit_tables import print_made
from cli.export_commands import add_export
from cli.failures import EXIT_FAILED, reports_errors
from cli.gallery_commands import add_mesh_gallery
from cli.hub_download import add_download
from cli.hub_upload import add_upload
from cli.making import make_with_progress, print_forecast
from cli.options import DryRun, Folder, Json, Limit, Out, Overwrite, Quiet, Seed, Workers
from cli.output import Sink, flat_lines
from cli.preview_commands import preview_digits
from cli.verification import verify_folder
from mnist3d.kind import KIND

if TYPE_CHECKING:
    from mnist3d.generation import GenerateSpec

__all__ = ["app", "main"]

app = new_app("mnist3d", "Printable 3D digits: from images of handwriting to validated data sets of meshes.")


class SplitName(StrEnum):
    """Splits of MNIST 3D on the command line."""

    train = "train"
    test = "test"
    holdout = "holdout"
    printed_train = "printed_train"
    printed_test = "printed_test"
    all = "all"


class ProfileName(StrEnum):
    """Profiles of the rim."""

    round = "round"
    linear = "linear"
    flat = "flat"


class SplitBy(StrEnum):
    """What is divided into splits."""

    digit = "digit"
    writer = "writer"


@app.command()
@reports_errors
def generate(
    split: Annotated[SplitName, typer.Option(help="Split to make.")] = SplitName.all,
    out: Out = Path("mnist3d-data"),
    source: Annotated[SourceName, typer.Option(help="Where the images come from.")] = SourceName.synthetic,
    images: Annotated[
        Path | None,
        typer.Option(
            metavar="PATH",
            help="Images of the source: the .npy file of HWD+, the folder of the MNIST files, or a folder of "
            "pictures DIR/<label>/*.png.",
        ),
    ] = None,
    writer_info: Annotated[
        Path | None, typer.Option(metavar="FILE", help="WriterInfo.npy of HWD+ (column 0 is the label).")
    ] = None,
    writer_column: Annotated[
        int | None, typer.Option(min=0, metavar="N", help="Column of WriterInfo.npy that holds the writer.")
    ] = None,
    download: Annotated[
        bool, typer.Option("--download", help="Fetch MNIST into --images first (extra `torch`).")
    ] = False,
    ink: Annotated[
        InkName | None, typer.Option(help="Ink of pictures in a folder.", show_default="auto")
    ] = None,
    digits: Annotated[
        int | None,
        typer.Option(
            min=1,
            metavar="N",
            help="How many digits the synthetic source holds.",
            show_default=str(SYNTHETIC_DIGITS),
        ),
    ] = None,
    seed: Seed = 0,
    split_by: Annotated[SplitBy, typer.Option(help="Divide single digits or whole writers.")] = SplitBy.digit,
    split_sizes: Annotated[
        str | None,
        typer.Option(
            metavar="train=8,test=2", help="Digits per class in each split instead of the published."
        ),
    ] = None,
    per_class: Annotated[
        int | None, typer.Option(min=1, metavar="N", help="Only the first N digits of each class of a split.")
    ] = None,
    limit: Limit = None,
    profile: Annotated[ProfileName, typer.Option(help="How the rim of a digit rises.")] = ProfileName.round,
    half_thickness_mm: Annotated[
        float, typer.Option(help="Height above the mid-plane of ink that is wide enough.")
    ] = 4.0,
    vertices: Annotated[int, typer.Option(metavar="N", help="Vertices of a mesh, about.")] = 5_000,
    join_bodies: Annotated[
        bool, typer.Option("--join-bodies", help="Bridge separate pieces so that a digit prints in one.")
    ] = False,
    workers: Workers = 0,
    overwrite: Overwrite = False,
    dry_run: DryRun = False,
    as_json: Json = False,
    quiet: Quiet = False,
) -> None:
    """Make a data set of printable 3D digits.

    Example: mnist3d generate --split train --per-class 10 --out digits

    A run that was stopped goes on when the same command is given again; finished shards are never made twice.
    """
    from mnist3d.generation import GenerateSpec
    from mnist3d.solid import SolidSpec
    from mnist3d.splits import SPLITS, SplitSpec

    spec = GenerateSpec(
        source=digit_source(source, images, writer_info, writer_column, download, ink, digits, seed),
        solid=SolidSpec(
            profile=profile.value,
            half_thickness_mm=half_thickness_mm,
            target_vertices=vertices,
            join_bodies=join_bodies,
        ),
        split=SplitSpec(seed, split_by.value, _sizes(split_sizes)),
        per_class=per_class,
        limit=limit,
    )
    splits = SPLITS if split is SplitName.all else (split.value,)
    sink = Sink(as_json, quiet)
    count = workers or os.cpu_count() or 1
    if dry_run:
        from mnist3d.generation import forecast

        view = forecast(spec, str(out), splits, count, overwrite=overwrite)
        print_forecast(sink, view, "digits", out, count)
    else:
        _run_generate(sink, spec, out, splits, count, overwrite)


@app.command()
@reports_errors
def validate(
    paths: Annotated[
        list[Path],
        typer.Argument(metavar="DIR|FILE...", help="Data set folders, or STL/3MF/PLY/OBJ/GLB files."),
    ],
    split: Annotated[SplitName, typer.Option(help="Split of a data set folder.")] = SplitName.all,
    limit: Limit = None,
    workers: Workers = 1,
    as_json: Json = False,
    quiet: Quiet = False,
) -> None:
    """Check meshes as read back from disk: whether each is a solid, and whether it will print.

    Example: mnist3d validate digits part.stl

    Exit code 1 when a mesh is no valid solid.
    """
    from mnist3d.validate import validate_paths

    sink = Sink(as_json, quiet)
    chosen = None if split is SplitName.all else split.value
    with sink.progress("checking", "meshes") as update:
        results = validate_paths(
            [str(path) for path in paths], chosen, limit, workers or os.cpu_count() or 1, on_progress=update
        )
    sink.document([result.to_dict() for result in results])
    for item in (item for result in results for item in result.unreadable):
        # Errors are said even to those who want to hear nothing else; they name the file.
        sys.stderr.write(f"unreadable: {item.report.detail}\n")
    for result in results:
        sink.table(*result.table())
    failed = sum(result.failed for result in results)
    checked = sum(result.checked for result in results)
    sink.line(f"{checked - failed:,} of {checked:,} meshes are valid solids")
    if failed:
        raise typer.Exit(EXIT_FAILED)


@app.command()
@reports_errors
def info(folder: Folder, as_json: Json = False) -> None:
    """Show what a data set folder holds and how it was made."""
    from tactile_toolkit.store.folder import DataFolder
    from tactile_toolkit.store.manifest import manifest_so_far

    place = DataFolder(str(folder))
    manifest = manifest_so_far(place)
    sink = Sink(as_json)
    if manifest is None:
        print_copy(sink, folder, KIND)
        return
    print_made(sink, manifest, folder)
    sink.line(f"made by tactile-toolkit {manifest.toolkit_version}; source and spec:")
    for line in flat_lines(manifest.spec):
        sink.line(f"  {line}")


@app.command()
@reports_errors
def verify(folder: Folder, as_json: Json = False, quiet: Quiet = False) -> None:
    """Check every checksum, row count, schema and id of a data set folder.

    Exit code 3 when something is damaged; each damaged file is named.
    """
    verify_folder(Sink(as_json, quiet), str(folder), KIND)


app.command("preview")(preview_digits)
add_card(app, KIND)
add_upload(app, KIND)
add_download(app, KIND)
add_mesh_gallery(app, KIND)
add_export(app, KIND)


def main() -> None:
    """Run the command line."""
    run(app)


def _sizes(text: str | None) -> tuple[tuple[str, int], ...] | None:
    """Parse ``train=8,test=2``."""
    from tactile_toolkit.errors import InputError

    if text is None:
        return None
    sizes: dict[str, int] = {}
    for part in text.split(","):
        split, equals, size = part.strip().partition("=")
        if not equals or not size.strip().isdecimal() or split in sizes:
            message = f"--split-sizes has {part!r}; expected SPLIT=N once per split, such as train=8,test=2"
            raise InputError(message)
        sizes[split] = int(size)
    return tuple(sizes.items())


def _run_generate(
    sink: Sink, spec: GenerateSpec, out: Path, splits: tuple[str, ...], workers: int, overwrite: bool
) -> None:
    from mnist3d.generation import generate as make
    from tactile_toolkit.run.worker import become_worker
    from tactile_toolkit.store.folder import DataFolder
    from tactile_toolkit.store.manifest import manifest_so_far

    become_worker()
    made = make_with_progress(
        sink,
        "making digits",
        "digits",
        lambda tell: make(spec, str(out), splits, workers=workers, overwrite=overwrite, on_progress=tell),
    )
    # Another split may be unfinished: what is finished of it stays and is told, as `info` tells it.
    print_made(sink, manifest_so_far(DataFolder(str(out))) or made.manifest, out, made.elapsed_s)
    sink.line(made.sentence("digits", out))
    table = made.manifest.split_table()
    split = next((name for name in splits if name in table and table[name]["rows"]), splits[0])
    sink.line(f"next: mnist3d validate {out}   or in Python: mnist3d.load({str(out)!r}, split={split!r})")
