"""The commands ``verify`` and ``validate``, which check the files of a data set folder and its objects."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Protocol

import typer

from cli import application, options, output
from tactile_toolkit import cards, catalog, mesh, places, run, store
from tactile_toolkit.checked_fields import integer, real, switch, text
from tactile_toolkit.errors import IntegrityError
from tactile_toolkit.json_types import JsonDict, JsonValue
from tactile_toolkit.kind import DatasetKind
from tactile_toolkit.wording import bytes_text, with_count


class Checked(Protocol):
    """Findings in a data set or a file."""

    @property
    def checked(self) -> int:
        """Number of checked objects."""

    @property
    def failed(self) -> int:
        """Number of objects that are not valid."""

    @property
    def unreadable(self) -> Sequence[str]:
        """Reasons why files or rows could not be read."""

    def to_dict(self) -> JsonDict:
        """Return JSON values."""

    def table(self) -> tuple[Sequence[str], Sequence[Sequence[object]], str]:
        """Return header, rows and title of a table."""

    def advice(self) -> Sequence[str]:
        """Return advice on warnings, one line for each."""


@dataclass(frozen=True, slots=True)
class Geometry:
    """Check of the objects of a kind.

    ``check`` takes names, a split or None, a limit or None and a number of processes, and the keywords
    ``opened``, a function that opens a name, and ``on_progress``.
    """

    nouns: str
    check: Callable[..., Sequence[Checked]]


@dataclass(frozen=True, slots=True)
class Objects:
    """Options of ``verify`` for kinds whose objects can be checked."""

    geometry: bool = switch(
        False, help="Also check the objects, as `validate` does; exit code 1 if one is invalid."
    )
    split: str | None = text(metavar="NAME", needs="geometry", help="Only the objects of this split.")
    limit: int | None = integer(
        None, 1, optional=True, needs="geometry", help="Only the first N objects of each split."
    )


def verify(
    *,
    kind: DatasetKind,
    checks: Geometry | None,
    folder: str = options.FOLDER,
    objects: Objects,
    workers: int = options.WORKERS,
    sink: output.Sink,
) -> None:
    """Check every checksum, row count, schema and id of a data set folder.

    Example: verify FOLDER

    Exit code 3 if something is damaged; each damaged file is named.
    """
    place = store.open_folder(folder)
    manifest = places.open_place(folder).require(kind, "verify").manifest
    result = store.verify(
        place, kind.schema_of(manifest), check_card=cards.check_card, workers=options.process_count(workers)
    )
    findings = [{"file": finding.file, "problem": finding.problem} for finding in result.findings]
    counts_of = {"files": result.files, "rows": result.rows}
    document = {"ok": result.ok, "reference": result.reference, **counts_of, "findings": findings}
    if result.ok:
        counts = f"{with_count(result.files, 'files')}, {with_count(result.rows, 'rows')}"
        sink.line(f"{folder}: {counts}, {bytes_text(result.bytes)}: all as in {result.reference}")
        if objects.geometry and checks is not None:
            check_objects(
                sink, checks, [folder], options.Opening(), objects.split, objects.limit, workers, document
            )
        else:
            sink.document(document)
        return
    sink.document(document)
    store.require_finished(place, [each.file for each in result.findings])
    for finding in result.findings:
        sink.warn(f"damaged: {finding.file}: {finding.problem}")  # the error below states only their number
    record = store.read_download_record(place)
    next_step = f"run the same `{kind.command_of(manifest)}` with --check, which makes damaged shards again"
    if record is not None:
        next_step = f"download {record.repo_id} there again; only damaged files are fetched"
    # Problems that no run repairs (unknown files, links, cards) state their own next step.
    if all("; next: " in finding.problem for finding in result.findings):
        next_step = "follow the next step of each problem"
    raise IntegrityError(f"{with_count(len(findings), 'problems')} in {folder!r}", next=next_step)


def validate(
    *,
    checks: Geometry,
    paths: list[str] = options.FOLDERS,
    opening: options.Opening,
    split: str | None = catalog.SPLIT,
    limit: int | None = catalog.LIMIT,
    unit: str | None = mesh.UNIT,
    nozzle_mm: float | None = real(
        None, above=0, optional=True, shown="0.4", help="Nozzle of the printer: walls need two lines of it."
    ),
    workers: int = options.WORKERS,
    sink: output.Sink,
) -> None:
    """Check each object of data sets, or of mesh files, as it is read back from disk.

    A digit must be a solid; warnings about printing it are listed. The objects of a scene must be solids
    that do not overlap, and the number of stars must be that of the label.

    Example: validate FOLDER

    Exit code 1 if an object is not valid. For a folder, `verify --geometry` checks its files as well.
    """
    profile = None if nozzle_mm is None else mesh.PrintProfile(nozzle_mm=nozzle_mm)
    checks = replace(checks, check=partial(checks.check, unit=unit, profile=profile))
    check_objects(sink, checks, paths, opening, split, limit, workers)


def check_objects(
    sink: output.Sink,
    geometry: Geometry,
    paths: Sequence[str],
    opening: options.Opening,
    split: str | None,
    limit: int | None,
    workers: int,
    verified: JsonDict | None = None,
) -> None:
    """Check objects as they are read back from disk.

    ``verified`` is the JSON document about the files of the folder, if these were checked before.
    """
    run.prepare_batch_process()
    if split == "all":
        split = None
    with sink.progress("checking", geometry.nouns) as update:
        opened = partial(opening.open, sink)
        workers = options.process_count(workers)
        results = geometry.check(paths, split, limit, workers, opened=opened, on_progress=update)
    documents: JsonValue = [result.to_dict() for result in results]
    if verified is not None:
        documents = {**verified, "geometry": documents}
    sink.document(documents)
    for result in results:
        for problem in result.unreadable:
            sink.warn(f"unreadable: {problem}")  # printed with --quiet, too, which prints no table
        sink.table(*result.table())
        for line in result.advice():
            sink.line(line)
    checked = sum(result.checked for result in results)
    failed = sum(result.failed for result in results)
    sink.line(f"{checked - failed:,} of {checked:,} {geometry.nouns} are valid")
    if failed:
        raise typer.Exit(application.EXIT_FAILED)
