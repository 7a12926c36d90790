"""The command ``import``, which makes a data set from the recordings of others."""

from __future__ import annotations

from dataclasses import MISSING
from functools import partial
from typing import Literal

import realtouch
from cli.options import Work, argument, out_folder
from cli.output import Sink
from cli.runs import make_with_progress, print_left_out, print_set
from realtouch.kind import KIND
from realtouch.touch_options import ImportColumns
from tactile_toolkit import store
from tactile_toolkit.checked_fields import choice, text
from tactile_toolkit.kind import DatasetKind
from tactile_toolkit.parsed_text import comma_separated


def import_touches(
    *,
    source: str = argument("DIR", "Folder of images and a CSV table, or of tars."),
    file_format: Literal["folder", "webdataset", "replay", "fota", "sparsh", "anytouch"] = choice(
        MISSING,
        ("folder", "webdataset", "replay", "fota", "sparsh", "anytouch"),
        name="--format",
        help="Layout of the images.",
    ),
    out: str = out_folder(),
    columns: ImportColumns,
    table: str | None = text(metavar="FILE", help="Path of the table; by default the only CSV file in DIR."),
    classes: list[str] | None = text(
        metavar="A,B", read=comma_separated, help="Names of the classes, in order; by default those found."
    ),
    split_name: str | None = text(
        name="--split",
        metavar="NAME",
        help="Name of the split, if no column has it; by default that of tars (SPLIT-000000.tar), or train.",
    ),
    work: Work,
    sink: Sink,
) -> None:
    """Make a data set of touches from images and a table of labels and poses; images are not changed.

    Images that cannot be used are left out and listed with the reason. Columns with the names that `realtouch
    frames` and `realtouch export` write need no option.

    Example: realtouch import pictures --format folder --image-column file --label-column digit --out touches
    """
    make = partial(
        realtouch.import_touches,
        source,
        out,
        file_format,
        columns,
        table=table,
        classes=classes or (),
        split=split_name,
    )
    make_with_progress(sink, "importing", KIND, make, work, out, _print_imported, "touches")


def _print_imported(
    sink: Sink, kind: DatasetKind, manifest: store.Manifest, out: str, _elapsed_s: float | None
) -> None:
    options = manifest.spec["options"]
    if realtouch.CONVERSION in options:
        sink.info(f"the images were converted without loss: {options[realtouch.CONVERSION]}")
    if not options["classes"]:
        sink.info("no classes are known (--label-column names their column), so all labels are -1")
    print_left_out(sink, manifest)
    fields = store.add_up(list(manifest.statistics().values())).get(realtouch.NOT_IMPORTED, {})
    if fields:
        counts = ", ".join(f"{name} ({count:,})" for name, count in fields.items())
        sink.info(f"fields that were not imported, with their numbers of touches: {counts}")
    print_set(sink, kind, manifest, out, left_out="touches")
