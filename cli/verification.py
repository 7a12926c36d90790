"""``verify`` as all command lines do it."""

from __future__ import annotations

import sys

from cli.output import Sink, bytes_text, counted
from tactile_toolkit.kind import DatasetKind

__all__ = ["verify_folder"]


def verify_folder(sink: Sink, folder: str, kind: DatasetKind) -> None:
    """Check a data set folder and print what was found.

    Parameters
    ----------
    sink : Sink
        Where to print.
    folder : str
        The folder.
    kind : DatasetKind
        What it is to hold.

    Raises
    ------
    IntegrityError
        When something is damaged; each damaged file is named on stderr.
    InputError
        When the folder holds no data set, or one of another kind.
    """
    from tactile_toolkit.cards.checks import check_card
    from tactile_toolkit.errors import IntegrityError
    from tactile_toolkit.store.folder import DataFolder
    from tactile_toolkit.store.manifest import read_manifest
    from tactile_toolkit.store.origin import read_record
    from tactile_toolkit.store.verify import verify

    place = DataFolder(folder)
    kind.refuse_other(read_manifest(place), place.address())
    result = verify(place, None if kind.schema is None else kind.schema(), check_card=check_card)
    findings = [{"file": finding.file, "problem": finding.problem} for finding in result.findings]
    counts_of = {"files": result.files, "rows": result.rows}
    sink.document({"ok": result.ok, "witness": result.reference, **counts_of, "findings": findings})
    if result.ok:
        size = bytes_text(result.bytes)
        counts = f"{counted(result.files, 'files')}, {counted(result.rows, 'rows')}, {size}"
        sink.line(f"{folder}: {counts}: all as {result.reference} says")
        return
    for finding in result.findings:
        sys.stderr.write(f"damaged: {finding.file}: {finding.problem}\n")
    record = read_record(place)
    if record is None:
        cure = f"run the same `{kind.made_by}` again, it makes the damaged shards anew"
    else:
        cure = f"download {record.repo_id} there again, only what is damaged is fetched"
    message = f"{counted(len(findings), 'problems')} in {folder!r}; next: {cure}"
    raise IntegrityError(message)
