"""The command ``import``, which makes a data set from the recordings of others."""

from __future__ import annotations

from dataclasses import asdict
from functools import partial

import realtouch
from cli import declared_options, output, runs
from cli.options import Making, argument, out_folder
from realtouch import touch_options
from realtouch.importing import import_columns
from realtouch.kind import KIND
from tactile_toolkit import store
from tactile_toolkit.checked_fields import choice, text
from tactile_toolkit.kind import DatasetKind
from tactile_toolkit.wording import comma_separated, with_count

_MAPPED = text(
    name="--map",
    metavar="NAME=COLUMN",
    several=True,
    help="Column of the image, label, round, object, position, pose, split or time; any other NAME renames "
    "a column. @FILE reads such lines from a file.",
)
_STREAMS = text(
    name="--stream",
    metavar="FILE",
    several=True,
    help="Table with times, such as poses or forces, that is aligned with the pictures.",
)


def import_touches(
    *,
    source: str = argument("SOURCE", "Folder or file of videos, images, episodes or arrays."),
    file_format: str | None = choice(
        None,
        touch_options.IMPORT_LAYOUTS,
        optional=True,
        name="--format",
        help="Format of the source; by default it is recognised by its content.",
    ),
    out: str = out_folder(),
    columns: import_columns.ImportColumns,
    mapped: list[str] | None = _MAPPED,
    table: str | None = text(
        metavar="FILE", help="Table of the images or videos; by default the only one in SOURCE."
    ),
    streams: list[str] | None = _STREAMS,
    alignment: touch_options.Alignment,
    cut: str | None = text(
        metavar="frames|whole|contact|FILE",
        help="How a recording is divided into touches: by picture, not at all, by contact, or by a table.",
    ),
    classes: list[str] | None = text(
        metavar="A,B", read=comma_separated, help="Names of the classes, in order; by default those found."
    ),
    split_name: str | None = text(
        name="--split",
        metavar="NAME",
        help="Name of the split, if no column has it; by default from the names of tars (SPLIT-000000.tar), "
        "or train.",
    ),
    making: Making,
    sink: output.Sink,
) -> None:
    """Make a data set of touches from recordings; pictures are stored unchanged if possible.

    Items that cannot be used are left out and listed with the reason. Columns with the names that `realtouch
    frames` and `realtouch export` write need no option; all others are kept.

    Example: realtouch import takes --map label=object --map pose=x_mm,y_mm,z_mm,qx,qy,qz,qw --out touches
    """
    reading: declared_options.Given = {
        "layout": file_format,
        "columns": columns.with_mapped(mapped or ()),
        "table": table,
        "streams": streams or (),
        "alignment": alignment,
        "cut": cut,
        "classes": classes or (),
        "split": split_name,
    }
    if making.dry_run:
        _print_preview(sink, realtouch.preview_import(source, **reading), out)
        return
    make = partial(realtouch.import_touches, source, out, **reading)
    if runs.make_with_progress(sink, "importing", KIND, make, making, out, _print_imported, "touches"):
        sink.line(f"next: realtouch check {out}   realtouch gallery {out}")


def _print_preview(sink: output.Sink, found: realtouch.ImportPreview, out: str) -> None:
    sink.document(asdict(found))
    by = f", recognised by {found.recognised_by}" if found.recognised_by else ""
    sink.line(f"format: {found.layout}{by}")
    if found.cut:
        sink.line(f"recordings are cut: {found.cut}")
    sink.line(f"pictures: {found.pictures}")
    sink.line(f"classes: {', '.join(found.classes) or 'none; all labels are -1'}")
    counts = ", ".join(f"{split} {count:,}" for split, count in found.splits.items())
    rounds = with_count(found.rounds, "rounds")
    sink.line(f"would make {with_count(found.touches, 'touches')} in {rounds} in {out}: {counts}")
    sink.table(("column", "becomes", "unit"), found.columns, title="columns of the source")
    names = dict.fromkeys(name for touch in found.first for name in touch)
    rows = [(name, *(touch.get(name, "") for touch in found.first)) for name in names]
    sink.table(("stored as", *(f"touch {number}" for number in range(len(found.first)))), rows)
    if found.streams:
        sink.table(touch_options.STREAM_HEADER, found.streams)
    if found.left_out:
        sink.table(("left out because of", "touches", "the first"), found.left_out)


def _print_imported(
    sink: output.Sink, kind: DatasetKind, manifest: store.Manifest, out: str, _elapsed_s: float | None
) -> None:
    options = manifest.spec["options"]
    if realtouch.CONVERSION in options:
        sink.info(f"pictures: {options[realtouch.CONVERSION]}")
    if not options["classes"]:
        sink.info("no classes are known (--map label=COLUMN names their column), so all labels are -1")
    if touch_options.STREAMS in manifest.spec:
        sink.table(touch_options.STREAM_HEADER, manifest.spec[touch_options.STREAMS])
    if touch_options.LEFT_OUT in manifest.spec:
        sink.info(f"not read: {', '.join(manifest.spec[touch_options.LEFT_OUT])}")
    runs.print_left_out(sink, manifest)
    counted = manifest.total_statistics()
    for note, count in counted.get(touch_options.CLIPS, {}).items():
        sink.info(f"{with_count(count, 'clips')}: {note}")
    fields = counted.get(realtouch.NOT_IMPORTED, {})
    if fields:
        counts = ", ".join(f"{name} ({count:,})" for name, count in fields.items())
        sink.info(f"fields that were not imported, with their numbers of touches: {counts}")
    runs.print_set(sink, kind, manifest, out, left_out="touches")
