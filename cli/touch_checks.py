"""The command ``realtouch check``: what is wrong with recordings whose files are intact."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict
from pathlib import Path

import typer

import realtouch
from cli import application, options, output
from realtouch import touch_options
from realtouch.touches import damage
from tactile_toolkit import catalog, pictures, store
from tactile_toolkit.checked_fields import choice, text
from tactile_toolkit.errors import InputError
from tactile_toolkit.kind import lazy
from tactile_toolkit.wording import with_count

_OXT_FINDINGS: Callable[[store.DataFolder, str], list[realtouch.RecordingFinding]] = lazy(
    "realtouch.exchange.oxt_check:oxt_findings"
)


def check(
    *,
    name: str = options.TOUCH_SET,
    split: str | None = catalog.SPLIT,
    opening: options.Opening,
    limits: touch_options.CheckLimits,
    drawn: Path | None = text(
        name="--pictures",
        metavar="DIR",
        read=options.local_place,
        help="Folder for a picture of each finding.",
    ),
    layout: str | None = choice(
        None,
        ("oxt",),
        name="--format",
        optional=True,
        shown="a set of touches",
        help="Check a folder or zip of another format against its contract.",
    ),
    workers: int = options.WORKERS,
    sink: output.Sink,
) -> None:
    """Find frozen frames, exchanged channels, duplicates and other faults of recordings.

    `verify` checks the files of a data set. Import other recordings first, with `import`. Exit code 1 if
    something is found.

    Examples: realtouch check touches --pictures found;  realtouch check --format oxt task.zarr.zip
    """
    if layout is not None:
        if split is not None or drawn is not None:
            raise InputError("--split and --pictures are for sets of touches, not for --format oxt")
        _report(sink, name, _oxt_findings(options.local_place(name)), {})
        return
    place = opening.open(sink, name)
    with sink.progress("checking", "rounds") as update:
        result = realtouch.check(
            place, split, limits=limits, workers=options.process_count(workers), on_progress=update
        )
    made: list[str] = []
    if drawn is not None and result.findings:
        folder = store.open_folder(str(drawn.absolute()))
        written = pictures.write_pictures(folder, result.pictures().pictures)
        made = [str(drawn / each.file) for each in written]
    sink.line(
        f"{name}: {with_count(result.rounds, 'rounds')}, {with_count(result.touches, 'touches')}; "
        f"all stored pictures were compared, {result.decoded:,} decoded"
    )
    for path in made:
        sink.line(f"drawn: {path}")
    counts = {"rounds": result.rounds, "touches": result.touches, "decoded": result.decoded}
    _report(sink, name, result.findings, {**counts, "pictures": made})


def _oxt_findings(path: Path) -> Sequence[realtouch.RecordingFinding]:
    """Check a folder, or a zip in one."""
    if not path.exists():
        raise InputError(f"{str(path)!r} does not exist; expected a folder or a zip", next="check the path")
    if path.is_file():
        return _OXT_FINDINGS(store.open_folder(str(path.parent)), path.name)
    return _OXT_FINDINGS(store.open_folder(str(path)), "")


def _report(
    sink: output.Sink, name: str, findings: Sequence[realtouch.RecordingFinding], counts: Mapping[str, object]
) -> None:
    """Print findings; exit code 1 if there are any."""
    sink.document({"name": name, "ok": not findings, **counts, "findings": list(map(asdict, findings))})
    for each in findings:
        sink.warn(f"{each.rule} in {each.where}: {each.found}; expected {each.expected}")
        named = ", ".join(each.touches)
        if len(each.touches) == damage.MAX_NAMED:
            named = f"{named}, ..."
        if each.count:
            sink.warn(f"  {with_count(each.count, 'touches')}: {named}")
        sink.warn(f"  next: {each.next}")
    if findings:
        sink.line(f"{with_count(len(findings), 'findings')} in {name}")
        raise typer.Exit(application.EXIT_FAILED)
    sink.line(f"{name}: nothing was found")
