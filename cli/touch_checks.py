"""The command ``realtouch check``: what is wrong with recordings whose files are intact."""

from __future__ import annotations

from dataclasses import asdict
from pathlib import Path

import typer

import realtouch
from cli import application, options, output
from realtouch import touch_options
from realtouch.touches import damage
from tactile_toolkit import catalog, pictures, store
from tactile_toolkit.checked_fields import text
from tactile_toolkit.wording import with_count


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
    workers: int = options.WORKERS,
    sink: output.Sink,
) -> None:
    """Find frozen frames, exchanged channels, duplicates and other faults of recordings.

    `verify` checks the files of a data set. Import other recordings first, with `import`. Exit code 1 if
    something is found.

    Examples: realtouch check touches --pictures found
    """
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
    sink.document(
        {
            "name": name,
            "ok": result.ok,
            "rounds": result.rounds,
            "touches": result.touches,
            "decoded": result.decoded,
            "findings": list(map(asdict, result.findings)),
            "pictures": made,
        }
    )
    for fault in result.findings:
        sink.warn(f"{fault.rule} in {fault.where}: {fault.found}; expected {fault.expected}")
        named = ", ".join(fault.touches)
        if len(fault.touches) == damage.MAX_NAMED:
            named = f"{named}, ..."
        if fault.count:
            sink.warn(f"  {with_count(fault.count, 'touches')}: {named}")
        sink.warn(f"  next: {fault.next}")
    if not result.ok:
        sink.line(f"{with_count(len(result.findings), 'findings')} in {name}")
        raise typer.Exit(application.EXIT_FAILED)
    sink.line(f"{name}: nothing was found")
