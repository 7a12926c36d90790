"""``mnist3d``: make, check and inspect data sets of printable 3D digits."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial
from typing import Annotated

import mnist3d
from cli import checks, declared_options, options, output, picture_prints, previews, runs, shared
from cli.application import command, new_app, run as run_app
from mnist3d import digit_options
from mnist3d.digit_options import SPLITS, SplitSpec
from mnist3d.kind import KIND
from tactile_toolkit import cards, catalog, checked_fields, mesh, places, run, store
from tactile_toolkit.kind import DatasetKind, lazy

app = new_app("mnist3d", "Printable 3D digits: from images of handwriting to validated data sets of meshes.")


@command(app)
def generate(
    *,
    split: str | None = checked_fields.choice(
        None,
        (*SPLITS, "all"),
        shown="all",
        help="Split to make. By default, all images of a folder are in train.",
    ),
    out: str = options.out_folder("mnist3d-data"),
    source: str = checked_fields.choice(
        "synthetic", digit_options.SOURCES, help="Where the images come from."
    ),
    images: Annotated[declared_options.Given, declared_options.OptionsOf(digit_options.SourceOptions)],
    division: SplitSpec,
    per_class: int | None = catalog.PER_CLASS,
    limit: int | None = catalog.LIMIT,
    solid: digit_options.SolidSpec,
    words: cards.OwnerWords,
    making: options.Making,
    sink: output.Sink,
) -> None:
    """Make a data set of printable 3D digits.

    Example: mnist3d generate --split train --per-class 10 --out digits

    After an interruption, the same command continues; finished shards are kept.
    """
    spec = mnist3d.DigitSetSpec(
        source=mnist3d.chosen_source(source, images, division.seed),
        solid=solid,
        split=division,
        per_class=per_class,
        limit=limit,
    )
    making_of = mnist3d.DigitGenerator.of(spec, None if split is None else SPLITS)
    splits: Sequence[str] | None = None
    if split == "all":
        splits = tuple(making_of.items())
    elif split is not None:
        splits = (split,)
    # Before the first digit, also for a forecast, which measures how long a worker takes.
    run.prepare_batch_process()
    runs.generate_set(sink, "making digits", making_of, out, splits, making, _print_made)
    if words.given() and not making.dry_run:
        folder = store.open_folder(out)
        manifest = store.read_manifest(folder)
        if manifest is not None and manifest.complete:
            cards.rewrite_card(KIND, folder, manifest, words)
        else:
            next_step = "state the licence and other words when it is finished"
            sink.info(f"note: {out} is unfinished; next: {next_step}")


def _print_made(
    sink: output.Sink, kind: DatasetKind, manifest: store.Manifest, out: str, elapsed_s: float | None
) -> None:
    from mnist3d.digit_card import facts_table  # pyarrow

    # The report that the figures come from is written at the end of a run.
    summaries = []
    if manifest.complete:
        summaries = mnist3d.summarise(store.open_folder(out), manifest)
    splits = [summary.to_dict() for summary in summaries] or manifest.split_table()
    skipped = manifest.skipped_reasons()
    facts = facts_table(summaries, mnist3d.SUMMED_UP)
    runs.print_left_out(sink, manifest)
    runs.print_set(sink, kind, manifest, out, elapsed_s, *facts, splits=splits, skipped=skipped)
    for line in mesh.print_advice(word for each in summaries for word in each.facets["warnings"]):
        sink.line(line)


_CHECKS = checks.Geometry("meshes", lazy("mnist3d.digit_checks:validate_paths"))


def _preview(
    *,
    path: str = options.argument(
        "DIR|FILE", "Data set folder, Parquet file, STL/3MF/PLY/OBJ/GLB file, or a picture of a digit."
    ),
    opening: options.Opening,
    spec: digit_options.DigitPreviewSpec,
    pictures: previews.Pictures,
    sink: output.Sink,
) -> None:
    """Write pictures of digits as PNG, without a screen: a sheet of each split, or steps from ink to mesh.

    Examples: mnist3d preview digits;  mnist3d preview digits --ids 17,408;  mnist3d preview part.stl
    """
    name: str | places.Place = path
    if not mnist3d.is_picture_or_mesh(path):
        name = opening.open(sink, path)
    pictures.write(sink, KIND.plan_previews(name, spec))


command(app)(picture_prints.solidify)
shared.add_shared(app, KIND, {"preview": _preview}, print_made=_print_made, checks=_CHECKS)

main = partial(run_app, app)
