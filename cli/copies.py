"""The commands that copy rows of data sets, export them, write their cards, and keep the cache."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from cli import application, contents, options, output, runs
from cli.options import AnySourceOptions, RunOptions, argument, out_folder
from realtouch.kind import KIND
from realtouch.touch_options import EXPORT_FORMATS, FRAME, TouchChoice
from tactile_toolkit import cache as caches, cards, catalog, checked_fields, places, printing, store, wording
from tactile_toolkit.checked_fields import choice, text
from tactile_toolkit.errors import InputError
from tactile_toolkit.kind import DatasetKind, lazy
from tactile_toolkit.wording import bytes_text, with_count

if TYPE_CHECKING:
    from tactile_toolkit.sets import DataSet

_MESH_FORMATS = ("stl", "3mf", "ply", "obj", "glb", "mjcf", "urdf", "usd", "flat")
_SHOW_FRAME = "png|jpeg|flat|webdataset|fota|anytouch"
# Imported when they are called: they import pyarrow.
_select_touches = lazy("realtouch:select")
_plan_export = lazy("realtouch.formats.exports:plan_export")


def _fractions(words: str) -> tuple[float, ...]:
    try:
        shares = tuple(map(float, wording.comma_separated(words)))
    except ValueError:
        shares = ()
    if not shares or not all(0 < share <= 1 for share in shares) or sum(shares) > 1 + 1e-9:
        raise InputError(
            f"is {words!r}; expected shares that add up to 1 or less, such as 0.8,0.2", field="fractions"
        )
    return shares


def select(
    *,
    name: str = options.NAME,
    source_options: AnySourceOptions,
    chosen: catalog.RowFilter,
    touches: Annotated[options.UserOptions, options.OptionsOf(TouchChoice)],
    out: str = out_folder("selected"),
    run_options: RunOptions,
    sink: output.Sink,
) -> None:
    """Write selected rows of a data set as a data set of the same kind.

    Examples: tactile select digits --labels 3,5 --per-class 10 --out some;
    tactile select real-single-64x64 --contact --out touched;
    tactile select touches --without findings.json --out clean
    """
    data = source_options.open_set(sink, name)
    make: Any = partial(data.select, chosen, out)
    if data.kind.has_touches:
        contents.announce_fetching(sink, data.place, chosen.split)
        wanted = {**TouchChoice(**touches).arguments(), **chosen.given()}
        make = partial(_select_touches, data.place, out, **wanted)
    else:
        options.refuse(touches, data.kind.nouns)
    manifest = runs.make_with_progress(sink, "copying", data.kind, make, run_options, out)
    if manifest is not None:
        left_out = Counter(entry["rule"] for entry in manifest.spec["options"].get("without", ()))
        for rule, count in left_out.items():
            sink.line(f"{rule}: touches of {with_count(count, 'rounds')} were left out")


def split(
    *,
    name: str = options.NAME,
    source_options: AnySourceOptions,
    out: str = out_folder("parts"),
    fractions: tuple[float, ...] = text(
        (),
        metavar="0.8,0.2",
        read=_fractions,
        help="Fractions of each split, one for each part.",
    ),
    seed: int = checked_fields.integer(0, needs="fractions", help="Random seed."),
    same_objects: bool = checked_fields.switch(
        False, help="Divide rows without regard to their objects, so that parts share objects."
    ),
    chosen: catalog.RowFilter,
    run_options: RunOptions,
    sink: output.Sink,
) -> None:
    """Divide a data set into several of the same kind: OUT/part-1, OUT/part-2 and so on.

    Objects are drawn at random (--fractions) with all their rows, or part-1 gets the objects that --ids,
    --labels and similar options choose, and part-2 all others. No object is in two parts.

    Examples: tactile split digits --fractions 0.8,0.2 --out parts;
    tactile split digits --ids 3,17,40-60 --out parts
    """
    data = source_options.open_set(sink, name)
    for folder, make in data.divide(out, fractions, seed, chosen, same_objects=same_objects):
        manifest = runs.make_with_progress(sink, "copying", data.kind, make, run_options, folder)
    if manifest is not None and manifest.spec["options"]["objects"] == "unknown":
        sink.warn(
            f"the objects of some {data.kind.nouns} are not known (no object_id), so the parts may share "
            "objects"
        )


def merge(
    *,
    names: list[str] = argument("NAME", "Data sets of one kind.", several=True),
    source_options: AnySourceOptions,
    out: str = out_folder("merged"),
    run_options: RunOptions,
    sink: output.Sink,
) -> None:
    """Merge data sets into one with the columns and classes of all; a column that a set lacks is null there.

    The columns source, source_id and licence state the data set of each row. If an id occurs again, the later
    row gets a new one. References to other data sets, such as object_id, are not changed.

    Example: tactile merge digits others --out both
    """
    data = source_options.open_set(sink, names[0])
    others = [source_options.open_source(sink, name) for name in names[1:]]
    make = partial(data.merge, others, out)
    manifest = runs.make_with_progress(sink, "copying", data.kind, make, run_options, out)
    if manifest is None:
        return
    merged = manifest.spec["options"]
    sink.line("; ".join(f"{source}: licence {licence}" for source, licence in merged["sources"].items()))
    if "new_ids" in merged:
        sink.line(
            f"{with_count(merged['new_ids'], 'ids')} occurred again and are new; the column source_id has "
            "those of the sources"
        )


@dataclass(frozen=True, slots=True)
class TouchFiles:
    """Options of the files of touches."""

    clip_frame: str = FRAME(needs=f"file_format={_SHOW_FRAME}", panel="Touches")
    difference: str | None = choice(
        None,
        ("grey", "absolute"),
        optional=True,
        needs="file_format=png|jpeg",
        panel="Touches",
        help="Write the difference from the median of the clip or round: grey (128 means no change) or "
        "absolute.",
    )


_FORMAT = choice(
    None,
    tuple(dict.fromkeys((*_MESH_FORMATS, *EXPORT_FORMATS))),
    optional=True,
    name="--format",
    shown="stl for meshes, plates 3mf",
    help="Meshes: files in mm (glb, mjcf, urdf, usd: in m), plates as 3mf or mjcf. Touches: png: exact "
    "pixels, jpeg: the stored JPEGs, with an index; webdataset: tars; lerobot: LeRobotDataset v3.0; "
    "oxt: Zarr of FTP-1; replay: Zarr of Diffusion Policy; fota: tars of T3; anytouch: list files. "
    "flat: Parquet tables, a row for each mesh or touch. lerobot, oxt and replay hold one split.",
)


def export(
    *,
    name: str = options.NAME,
    source_options: AnySourceOptions,
    file_format: str | None = _FORMAT,
    meshes: Annotated[options.UserOptions, options.OptionsOf(printing.ExportOptions)],
    chosen: catalog.RowFilter,
    touches: Annotated[options.UserOptions, options.OptionsOf(TouchFiles)],
    out: str = out_folder("exported"),
    run_options: options.GenerateOptions,
    sink: output.Sink,
) -> None:
    """Write files for printers, simulators and other libraries.

    A mesh becomes a file, or a part of a build plate, or a row of a table. Objects keep their pose; their
    lowest point is at z = 0. Every file is read back; one that is not the same solid is removed and named.
    Touches become pictures, or the files of another library; stored JPEGs are copied, never encoded again.

    Examples: tactile export digits --ids 3,17 --format 3mf;
    tactile export digits --per-class 1 --plate 256x256;
    tactile export digits --calibration-plate --out plate;
    tactile export real-seq --split train --format lerobot --out robots

    After an interruption, the same command continues; finished files are kept.

    Exit code 1 if an object or plate could not be written as a solid.
    """
    data = source_options.open_set(sink, name)
    kind = data.kind
    if kind.has_touches:
        _require_format(kind, file_format, EXPORT_FORMATS)
        options.refuse(meshes, kind.nouns)
        contents.announce_fetching(sink, data.place, chosen.split)
        plan = _plan_export(
            *(data.place, out, file_format, touches.get("clip_frame"), touches.get("difference")),
            replace(chosen, split=chosen.only_split),
        )
        nouns = "touches" if file_format in ("png", "jpeg") else "rows"
        _write_rows(sink, replace(KIND, nouns=nouns), plan, out, run_options, KIND.nouns)
        return
    _require_format(kind, file_format or "stl", _MESH_FORMATS)
    options.refuse(touches, kind.nouns)
    out = str(options.parse_local_path(out))
    if file_format == "flat":
        _write_rows(sink, kind, data.plan_tables(chosen, out), out, run_options, kind.nouns)
        return
    options.refuse(run_options.given(), "mesh files")
    _write_meshes(sink, data, chosen, out, printing.ExportOptions(file_format, **meshes), run_options)


def _write_meshes(
    sink: output.Sink,
    data: DataSet,
    chosen: catalog.RowFilter,
    out: str,
    mesh_options: printing.ExportOptions,
    run_options: options.GenerateOptions,
) -> None:
    """Write mesh files or plates of a data set, and print which; exit code 1 if one could not be written."""
    report = data.export_meshes(
        *(chosen, out, mesh_options, sink.progress),
        overwrite=run_options.overwrite,
        dry_run=run_options.dry_run,
        workers=options.process_count(run_options.workers),
    )
    sink.document({"out": out, **report.document})
    if report.removed:
        removed = "would remove" if run_options.dry_run else "removed"
        sink.info(f"{removed} plates of an earlier export: {', '.join(report.removed)}")
    sink.table(report.header, report.rows)
    if report.line:
        sink.line(report.line)
    for failure in report.failed:
        sink.warn(f"failed: {failure.name}: {failure.detail}")
    if report.failed:
        raise typer.Exit(application.EXIT_FAILED)


def _require_format(kind: DatasetKind, file_format: str | None, known: tuple[str, ...]) -> None:
    """Refuse a format that rows of a kind do not have (InputError)."""
    if file_format not in known:
        problem = "is needed" if file_format is None else f"is {file_format!r}"
        raise InputError(
            f"{problem}; expected one of {', '.join(known)} for {kind.nouns}",
            next=f"give --format {known[0]}",
            field="file_format",
        )


def _write_rows(
    sink: output.Sink,
    kind: DatasetKind,
    plan: store.BuildPlan,
    out: str,
    run_options: options.GenerateOptions,
    nouns: str,
) -> None:
    """Write rows and their files, or print how many would be written; ``nouns`` are those of the source."""
    folder = store.open_folder(out)
    if run_options.dry_run:
        if not run_options.overwrite:
            plan.compared_with(folder)
        rows = sum(task.size for task in plan.tasks)
        sink.document({"folder": out, "rows": rows})
        sink.line(f"would write {with_count(rows, nouns)} to {out}; nothing was written")
        return
    make = partial(store.build, folder, plan, write_card=kind.write_card)
    if runs.make_with_progress(sink, "writing", kind, make, run_options, out, nouns) and plan.extra_dirs:
        sink.line(f"other programs open {', '.join(f'{out}/{name}' for name in plan.extra_dirs)}")


def card(
    *,
    folder: str = options.FOLDER,
    kind: str | None = options.KIND,
    words: cards.OwnerWords,
    sink: output.Sink,
) -> None:
    """Write the data card (README.md) of a folder again, with the picture that it shows, and check it.

    Numbers are computed from the data; examples name FOLDER until the folder is uploaded. Licence, authors,
    title and citation that were given before are kept.

    Examples: tactile card digits;
    tactile card digits --license cc-by-4.0 --author "Ada Lovelace" --title "My digits"
    """
    place = places.open_place(folder).require_complete(may_take=False)
    files = options.data_set(place, place.choose_kind(kind)).rewrite_card(words)
    sink.document({"folder": folder, "card": files[0], "previews": files[1:]})
    sink.line(f"{folder}: wrote {', '.join(files)}; all of it matches the data")


def cache(
    *,
    prune: bool = checked_fields.switch(False, help="Remove the files, which are made again when needed."),
    unused_days: float = checked_fields.real(
        0.0, 0, metavar="DAYS", needs="prune", help="Only files not used for this many days."
    ),
    sink: output.Sink,
) -> None:
    """List or remove cached files.

    Files from the Hub are in the Hub's own cache: see `hf cache`.

    Examples: tactile cache;  tactile cache --prune --unused-days 30
    """
    before = caches.CacheContents.now()
    removed = list[Path]()
    if prune:
        removed = before.prune(unused_days)
    rows = [(name, len(files), sum(size for _, size, _ in files)) for name, files in before.files.items()]
    document = {name: {"files": count, "bytes": size} for name, count, size in rows}
    sink.document({"folder": str(before.folder), "held": document, "removed": list(map(str, removed))})
    if prune:
        sink.line(f"removed {with_count(len(removed), 'files')} of {before.folder}")
        return
    sink.table(("what", "files", "size"), [(name, count, bytes_text(size)) for name, count, size in rows])
    sink.line(f"these files are in {before.folder}; next: `tactile cache --prune` removes them")
