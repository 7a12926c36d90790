"""The commands that show and check what a data set holds."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

import typer

from cli import application, options, output, runs
from tactile_toolkit import catalog, checked_fields, places, run, store
from tactile_toolkit.errors import InputError, IntegrityError
from tactile_toolkit.kind import DatasetKind, lazy
from tactile_toolkit.value_types import JsonDict, JsonValue
from tactile_toolkit.wording import bytes_text, with_count

# Imported when they are called: they import pyarrow.
_list_sets = lazy("tactile_toolkit.sets:list_sets")
_stored_row = lazy("tactile_toolkit.sets:stored_row")
_verify_touches = lazy("realtouch:verify")
_check_touches = lazy("realtouch:check")
_summarise_splits = lazy("realtouch.touches.loading:summarise_splits")
_is_sensor = lazy("tactile_sim.twin.sensor_repositories:is_sensor")
_sensor_facts = lazy("tactile_sim.twin.sensor_repositories:sensor_facts")
_sensor_named = lazy("tactile_sim:SensorModel.named")


def list_sets(
    *,
    folder: str | None = options.argument(
        "DIR", "Folder of data sets; the published ones by default.", default=None
    ),
    sink: output.Sink,
) -> None:
    """List the published data sets and which of them are on this machine, or the data sets in a folder.

    Examples: tactile list;  tactile list .
    """
    sets = _list_sets(folder and options.parse_local_path(folder))
    sink.document(sets)
    if folder is None:
        _print_published(sink, sets)
        return
    rows = [list({**entry, "bytes": bytes_text(entry["bytes"])}.values()) for entry in sets]
    sink.table(("name", "kind", "splits", "rows", "Parquet", "state"), rows)
    sink.line(f"{with_count(len(sets), 'data sets')} in {folder}")


def _print_published(sink: output.Sink, sets: Sequence[JsonDict]) -> None:
    """Print the published data sets: content, licence, size, and which splits are on this machine."""
    rows = []
    for known in sets:
        there = "?" if known["hub_bytes"] is None else bytes_text(known["hub_bytes"])
        here = "-"
        if known["local_bytes"]:
            here = f"{bytes_text(known['local_bytes'])} ({', '.join(known['local_splits'])})"
        rows.append((known["name"], known["content"], known["licence"] or "see its card", there, here))
    sink.table(("name", "holds", "licence", "on the Hub", "here"), rows)
    if any(row[3] == "?" for row in rows):
        sink.info("?: the Hub did not answer for this one (no network, or no access)")
    sink.line("next: tactile download NAME [--split SPLIT] [--out DIR]")


def info(
    *,
    name: str = options.argument("NAME|SENSOR", "Data set, or a sensor by its folder or name."),
    split: str | None = catalog.row_option("split"),
    name_options: options.NameOptions,
    kind: str | None = options.KIND,
    sink: output.Sink,
) -> None:
    """Show what a data set or a sensor holds, and how it was made.

    Examples: tactile info digits;  tactile info real-single-64x64 --split test;  tactile info my-sensor
    """
    if _is_sensor(name):
        options.refuse({"split": split, **asdict(name_options), "kind": kind}, "a sensor")
        print_sensor(sink, _sensor_named(name))
        return
    place = name_options.open(sink, name)
    place.chosen_splits(split)  # refuses an unknown one
    chosen = place.choose_kind(kind)
    manifest = place.manifest
    operation = None
    if manifest is not None:
        operation = (
            manifest.operation(f"{name}/{store.MANIFEST_FILE}")
            if chosen.has_touches
            else manifest.spec.get("operation")
        )
    is_own = manifest is not None and chosen.is_told_by(manifest)
    if chosen.has_touches and chosen.facts is None and (manifest is None or (manifest.complete and is_own)):
        _print_touches(sink, place, split)
    elif manifest is None:
        _print_counts(sink, place, chosen, split)
        return
    else:
        runs.print_set(sink, chosen, manifest, place.name, split=split, has_folder=place.folder is not None)
    if manifest is not None and is_own:
        sink.line(f"made by `{chosen.command_of(manifest)}` of tactile-toolkit {manifest.toolkit_version}:")
        for line in _flat_lines(manifest.spec.get("options") if operation else manifest.spec):
            sink.line(f"  {line}")


def _print_touches(sink: output.Sink, place: places.Place, split: str | None) -> None:
    """Print the figures of touches, which are read from their rows."""
    announce_fetching(sink, place, split)
    summaries = _summarise_splits(place, split)
    splits = {name: summary.to_dict() for name, summary in summaries.items()}
    sink.document({"name": place.name, "splits": splits, "spec": place.manifest and place.manifest.spec})
    for name, summary in summaries.items():
        sink.table((name, summary.kind), summary.table())


def _print_counts(sink: output.Sink, place: places.Place, kind: DatasetKind, split: str | None) -> None:
    """Print the content of the splits of a data set without a manifest here, and its repository."""
    repository = place.download or place.repository
    entries = options.data_set(place, kind).count_splits(split)
    source: dict[str, str | None] = {"repository": None, "commit": None}
    origin = "no manifest"
    if repository:
        source = {"repository": repository.repo_id, "commit": repository.commit}
        origin = f"downloaded from {repository.repo_id} at {repository.commit[:12]}"
    sink.document({"folder": place.name, **source, "splits": entries})
    rows = []
    for entry in entries:
        classes = ", ".join(f"{name}: {count:,}" for name, count in entry["per_class"].items())
        rows.append((entry["split"], entry["rows"], entry["shards"], bytes_text(entry["bytes"]), classes))
    sink.table(("split", kind.nouns, "shards", "Parquet", "per class"), rows)
    sink.line(f"{origin}: no provenance recorded")


def print_sensor(sink: output.Sink, model: Any) -> None:
    """Print the facts of a sensor, and the touches that its calibration left out."""
    sink.document({"sensor": model.to_dict(), "report": dict(model.report)})
    sink.table(("sensor", model.name), list(_sensor_facts(model).items()))
    touches = model.report.get("touches", [])
    if touches:
        used = sum(bool(touch["used"]) for touch in touches)
        sink.line(f"calibrated with {used} of {with_count(len(touches), 'touches')}")
    for touch in touches:
        if not touch["used"]:
            sink.line(f"  left out: {touch['name']}: {touch['reason']}")


def announce_fetching(sink: output.Sink, place: places.Place, split: str | None) -> None:
    """Print which splits will be fetched from the Hub, as published data sets have many gigabytes."""
    if place.repository is None:
        return
    part = "all splits (--split selects one)"
    if split:
        part = f"split {split!r}"
    sink.info(f"{place.repository.repo_id}: fetching the missing files of {part} from the Hub")


def _flat_lines(values: JsonValue, path: str = "") -> list[str]:
    """Return nested values as lines such as ``solid.profile = round``."""
    if isinstance(values, dict) and values:
        inner = values.items()
    elif isinstance(values, list) and any(isinstance(value, (dict, list)) for value in values):
        inner = dict(enumerate(values, 1)).items()
    else:
        return [f"{path} = {_value_text(values)}"]
    return [line for key, value in inner for line in _flat_lines(value, f"{path}.{key}".lstrip("."))]


def _value_text(value: JsonValue) -> str:
    if value is None or value in ([], {}):
        return "none"
    if isinstance(value, list):
        return ", ".join(map(_value_text, value))
    if isinstance(value, bool):
        return "yes" if value else "no"
    return str(value)


def show(
    *,
    name: str = options.NAME,
    row: int = checked_fields.integer(0, help="Number of the row in its split, from 0."),
    split: str | None = checked_fields.text(metavar="NAME", help="Split of the row; the first by default."),
    name_options: options.NameOptions,
    sink: output.Sink,
) -> None:
    """Show a row of a data set: each column, its type and its value, or the number of its values.

    Example: tactile show digits --row 3 --split test
    """
    place = name_options.open(sink, name)
    stored = _stored_row(place, row, split)
    sink.document({"data_set": name, "split": stored.split, "row": row, "values": stored.values})
    sink.line(f"{name}: row {row:,} of the {with_count(stored.rows, 'rows')} in {stored.split}")
    lines = []
    for column, value in stored.values.items():
        for line in _flat_lines({column: value}):
            path, _, text = line.partition(" = ")
            lines.append((path, stored.types[column], text))
    sink.table(("column", "type", "value"), lines)


def verify(
    *,
    name: str = options.NAME,
    split: str | None = catalog.row_option("split"),
    quick: bool = checked_fields.switch(False, help="Read only the headers of images; decode none."),
    content: bool = checked_fields.switch(
        False, help="Also check what rows hold: solids, overlaps, faults of recordings; exit code 1."
    ),
    name_options: options.NameOptions,
    kind: str | None = options.KIND,
    workers: int = options.WORKERS,
    sink: output.Sink,
) -> None:
    """Check every checksum, row, image and id of a data set.

    Examples: tactile verify digits --content;  tactile verify real-single-64x64 --split test

    Exit code 3 if something is damaged; each damaged file is named.
    """
    place = name_options.open(sink, name)
    # Before files are checked, which takes long. A single file is opened as any split.
    place.chosen_splits(None if split == "all" else split)
    chosen = place.choose_kind(kind)
    is_for_others = place.manifest is not None and place.manifest.is_for_others
    if chosen.has_touches and (chosen.name == "realtouch" or not is_for_others):
        document = verify_touches(sink, place, split, workers, quick=quick)
    else:
        options.refuse({"quick": quick, "split": split and not content}, f"the files of {chosen.nouns}")
        document = _verify_files(sink, place, chosen, workers)
    is_failed = False
    if content and chosen.has_touches:
        document["faults"] = print_faults(sink, place, split, workers)
        is_failed = not document["faults"]["ok"]
    elif content:
        document["content"] = print_content(sink, chosen, [place], split, None, workers)
        is_failed = any(result["failed"] for result in document["content"])
    sink.document(document)
    if is_failed:
        raise typer.Exit(application.EXIT_FAILED)


def _verify_files(sink: output.Sink, place: places.Place, kind: DatasetKind, workers: int) -> JsonDict:
    """Check the files of a folder and return the document; IntegrityError if there is damage."""
    result = options.data_set(place, kind).verify(options.process_count(workers))
    problems = [{"file": finding.file, "problem": finding.problem} for finding in result.findings]
    document = {
        "ok": result.ok,
        "reference": result.reference,
        "files": result.files,
        "rows": result.rows,
        "findings": problems,
    }
    if result.ok:
        counts = f"{with_count(result.files, 'files')}, {with_count(result.rows, 'rows')}"
        sink.line(f"{place.name}: {counts}, {bytes_text(result.bytes)}: all as in {result.reference}")
        return document
    sink.document(document)
    place.require_finished([finding.file for finding in result.findings])
    next_step = (
        f"run the same `{kind.command_of(place.manifest)}` with --repair, which makes damaged shards again"
    )
    if place.download is not None:
        next_step = f"download {place.download.repo_id} there again; only damaged files are fetched"
    # Problems that no run repairs (unknown files, links, cards) state their own next step.
    if all("; next: " in finding.problem for finding in result.findings):
        next_step = "follow the next step of each problem"
    raise _damaged(sink, place, result.findings, next_step)


def _damaged(
    sink: output.Sink, place: places.Place, findings: Sequence[object], next_step: str
) -> IntegrityError:
    """Print each damage and return the error, which states only their number."""
    for finding in findings:
        sink.warn(f"damaged: {finding}")
    return IntegrityError(f"{with_count(len(findings), 'problems')} in {place.name!r}", next=next_step)


def verify_touches(
    sink: output.Sink,
    place: places.Place,
    split: str | None,
    workers: int = 0,
    *,
    quick: bool,
    allows_unfinished: bool = False,
) -> JsonDict:
    """Check touches and return the document; IntegrityError, after all damage was named, if there is some."""
    with sink.progress("checking", "rounds") as update:
        result = _verify_touches(
            place, split, quick=quick, workers=options.process_count(workers), on_progress=update
        )
    # The manifest of an unfinished data set is a finding, too.
    findings = [
        finding
        for finding in result.findings
        if not (allows_unfinished and finding.file == store.MANIFEST_FILE)
    ]
    problems = list(map(asdict, findings))
    document = {
        "ok": not findings,
        "rounds": result.rounds,
        "touches": result.touches,
        "findings": problems,
        "unprotected": list(result.unprotected),
    }
    if findings:
        sink.document(document)
        if not allows_unfinished:
            place.require_finished([finding.file for finding in result.findings])
        next_step = "download or convert it again"
        if place.unfinished:
            next_step = "run the same command with --repair, which makes damaged shards again"
        raise _damaged(sink, place, findings, next_step)
    how = "every header was read" if quick else "every picture was decoded"
    counts = f"{with_count(result.rounds, 'rounds')}, {with_count(result.touches, 'touches')}"
    sink.line(f"{place.name}: {counts}: nothing is wrong; {how}")
    if result.unprotected:
        sink.line(
            f"{with_count(len(result.unprotected), 'files')} unprotected, {result.unprotected[0]!r} first: "
            "neither their pages, nor a manifest, nor the Hub have checksums, so a changed number is not "
            "noticed"
        )
    return document


def print_content(
    sink: output.Sink,
    kind: DatasetKind,
    sources: Sequence[str | places.Place],
    split: str | None,
    limit: int | None,
    workers: int,
    **further: object,
) -> list[JsonDict]:
    """Check each object as it is read back from disk, print the findings and return their documents.

    ``sources`` are opened data sets or, for digits, mesh files; ``further`` are arguments of the check of
    the kind.
    """
    if kind.check_content is None:
        raise InputError(f"has no effect on {kind.nouns}", next="leave it out", field="content")
    run.prepare_batch_process()
    nouns = "meshes" if kind.name == "mnist3d" else kind.nouns
    with sink.progress("checking", nouns) as update:
        chosen = None if split == "all" else split
        processes = options.process_count(workers)
        results = [
            kind.check_content(source, chosen, limit, processes, on_progress=update, **further)
            for source in sources
        ]
    for result in results:
        for problem in result.unreadable:
            sink.warn(f"unreadable: {problem}")  # printed with --quiet, too, which prints no table
        sink.table(*result.table())
        for line in result.advice():
            sink.line(line)
    checked = sum(result.checked for result in results)
    failed = sum(result.failed for result in results)
    sink.line(f"{checked - failed:,} of {checked:,} {nouns} are valid")
    return [result.to_dict() for result in results]


def print_faults(
    sink: output.Sink,
    place: places.Place,
    split: str | None,
    workers: int,
    limits: object = None,
    drawn: Path | None = None,
) -> JsonDict:
    """Look for faults of recordings, print them, and return the document.

    ``limits`` are those of :func:`realtouch.check`; ``drawn`` is a folder for pictures of the faults.
    """
    with sink.progress("checking", "rounds") as update:
        result = _check_touches(
            place, split, limits=limits, workers=options.process_count(workers), on_progress=update
        )
    drawings: list[str] = []
    if drawn is not None and result.findings:
        drawings = [str(drawn / picture.file) for picture in result.pictures().write(drawn.absolute())]
    sink.line(
        f"{place.name}: {with_count(result.rounds, 'rounds')}, {with_count(result.touches, 'touches')}; "
        f"all stored pictures were compared, {result.decoded:,} decoded"
    )
    for path in drawings:
        sink.line(f"drawn: {path}")
    for fault in result.findings:
        sink.warn(f"{fault.rule} in {fault.splits}: {fault.found}; expected {fault.expected}")
        named = ", ".join(fault.touches)
        if len(fault.touches) < fault.count:
            named = f"{named}, ..."
        if fault.count:
            sink.warn(f"  {with_count(fault.count, 'touches')}: {named}")
        sink.warn(f"  next: {fault.next}")
    count_text = "nothing was found"
    if not result.ok:
        count_text = with_count(len(result.findings), "findings")
    sink.line(f"{place.name}: {count_text}")
    return {
        "name": place.name,
        "ok": result.ok,
        "rounds": result.rounds,
        "touches": result.touches,
        "decoded": result.decoded,
        "findings": list(map(asdict, result.findings)),
        "pictures": drawings,
    }
