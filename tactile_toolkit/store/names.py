"""Names of files that come from outside: manifests, records, rows, archives, the Hub.

Whoever wrote them may be anyone, and a name decides what is read, overwritten or deleted. All of them pass
:func:`names_inside`.
"""

from __future__ import annotations

import re
import unicodedata
from collections.abc import Iterable

from tactile_toolkit.errors import IntegrityError

_LONGEST_BYTES = 1024
# File systems take 255 bytes; while a file is written, host, process and time stand before its name.
_LONGEST_PART_BYTES = 150
_DRIVE = re.compile("[A-Za-z]:")
_PORTS = frozenset(f"{port}{number}" for port in ("com", "lpt") for number in "0123456789¹²³")
_WINDOWS_DEVICES = _PORTS | {"con", "prn", "aux", "nul", "conin$", "conout$"}
_SHOWN = 80


def problem_of_name(name: object) -> str:
    """Say why a name, a path with slashes, cannot be that of a file of a data set; empty where it can."""
    if not isinstance(name, str):
        return "is not a text"
    if not name or len(name.encode(errors="replace")) > _LONGEST_BYTES:
        return f"is not of 1 to {_LONGEST_BYTES:,} bytes"
    if not name.isprintable():
        return "holds control characters"
    for part in name.split("/"):
        if part in ("", ".", "..") or "\\" in part or _DRIVE.match(part):
            return "leads out of the folder on some system, or is not a plain relative path"
        if part.startswith("."):
            return "is hidden, and data sets have no hidden files"
        if part.endswith((".", " ")) or part.partition(".")[0].rstrip().casefold() in _WINDOWS_DEVICES:
            return "means something else on Windows"
        if len(part.encode(errors="replace")) > _LONGEST_PART_BYTES:
            return f"has a part of more than {_LONGEST_PART_BYTES} bytes"
    return ""


def names_inside(names: Iterable[object], where: str) -> tuple[str, ...]:
    """Return names of files that belong together, if each can stand for one file in a folder of ours.

    ``where`` says, for the message, who gave the names. Raises IntegrityError for one that cannot (it leads
    out of the folder, is hidden, or is not a name on every system), and for two that are one file where case
    does not count.
    """
    seen: dict[str, str] = {}
    for name in names:
        problem = problem_of_name(name)
        if not problem:
            text = str(name)
            first = seen.setdefault(unicodedata.normalize("NFC", text).casefold(), text)
            problem = "" if first == text else f"is the same file as {first!r} where case does not count"
        if problem:
            shown = ascii(name)
            shown = shown if len(shown) <= _SHOWN else f"{shown[:_SHOWN]}..."
            raise IntegrityError(
                f"{where} names the file {shown}, which {problem}; expected plain relative paths; nothing "
                "was done with it",
                next="do not use this data set, or ask who made it",
            )
    return tuple(seen.values())
