"""``verify`` as all command lines do it."""

from __future__ import annotations

import sys
from typing import Any

from cli.output import Sink, bytes_text, counted
from cli.rooms import Room

__all__ = ["verify_folder"]


def verify_folder(sink: Sink, folder: str, schema: Any, generate: str) -> None:
    """Check a data set folder and print what was found.

    Parameters
    ----------
    sink : Sink
        Where to print.
    folder : str
        The folder.
    schema : pyarrow.Schema
        Schema of its rows.
    generate : str
        Command that makes damaged shards anew, where the folder was not downloaded.

    Raises
    ------
    IntegrityError
        When something is damaged; each damaged file is named on stderr.
    InputError
        When the folder holds no data set, or one of another kind.
    """
    from tactile_toolkit.errors import IntegrityError
    from tactile_toolkit.store.folder import DataFolder
    from tactile_toolkit.store.manifest import read_manifest
    from tactile_toolkit.store.origin import read_record
    from tactile_toolkit.store.verify import verify

    place = DataFolder(folder)
    command, made = generate.split()
    Room(command if made == "generate" else made).refuse_other_kind(read_manifest(place), place.address())
    result = verify(place, schema, card=True)
    findings = [{"file": finding.file, "problem": finding.problem} for finding in result.findings]
    counts_of = {"files": result.files, "rows": result.rows}
    sink.document({"ok": result.ok, "witness": result.witness, **counts_of, "findings": findings})
    if result.ok:
        size = bytes_text(result.bytes)
        counts = f"{counted(result.files, 'files')}, {counted(result.rows, 'rows')}, {size}"
        sink.line(f"{folder}: {counts}: all as {result.witness} says")
        return
    for finding in result.findings:
        sys.stderr.write(f"damaged: {finding.file}: {finding.problem}\n")
    record = read_record(place)
    if record is None:
        cure = f"run the same `{generate}` again, it makes the damaged shards anew"
    else:
        cure = f"download {record.repo_id} there again, only what is damaged is fetched"
    message = f"{counted(len(findings), 'problems')} in {folder!r}; next: {cure}"
    raise IntegrityError(message)
