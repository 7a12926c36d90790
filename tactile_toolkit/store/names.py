"""Names of files that come from outside: a name decides what is read, overwritten or deleted."""

from __future__ import annotations

import re
import unicodedata
from collections.abc import Iterable
from functools import lru_cache

from tactile_toolkit.errors import IntegrityError
from tactile_toolkit.wording import shortened

_LONGEST_BYTES = 1024
# File systems take 255 bytes; while a file is written, its name has a prefix.
_LONGEST_PART_BYTES = 150
_DEVICE = r"(?:con|prn|aux|nul|conin\$|conout\$|(?:com|lpt)[0-9¹²³])\s*(?:[.:/]|\Z)"
# One search for the whole path: an import asks for 50,000 of them.
_ELSEWHERE = re.compile(rf"\A/|[\0\\]|(?:\A|/)(?:\.\.(?:/|\Z)|[a-z]:|{_DEVICE})", re.IGNORECASE)
_SHOWN = 80
_STEPS = frozenset({".", ".."})
# Files that systems leave in folders and archives, in lower case; names with a leading dot are hidden anyway.
_LEFT_BY_SYSTEMS = frozenset(
    {
        "__macosx",
        "@eadir",
        "#recycle",
        "$recycle.bin",
        "system volume information",
        "thumbs.db",
        "ehthumbs.db",
        "desktop.ini",
    }
)


def is_hidden(path: str) -> bool:
    """Return whether listings skip a relative path, with slashes.

    They do if a part of the path begins with a dot (``._a.png``, ``.DS_Store``) or is one that systems
    leave in folders and archives (``__MACOSX``, ``@eaDir``, ``Thumbs.db``, ``desktop.ini``, ...). A path that
    leads elsewhere (``../a.png``) is not hidden, but wrong.
    """
    return any(map(_is_hidden_part, path.split("/")))


@lru_cache(maxsize=1024)
def _is_hidden_part(part: str) -> bool:
    return (part[:1] == "." and part not in _STEPS) or part.lower() in _LEFT_BY_SYSTEMS


def problem_of_name(name: object) -> str:
    """Return why a path with slashes cannot name a file of a data set; empty if it can."""
    is_plain = (
        isinstance(name, str)
        and name.isprintable()
        and len(name.encode(errors="replace")) <= _LONGEST_BYTES
        and all(map(_is_plain_part, name.split("/")))
    )
    if is_plain:
        return ""
    return "is not the plain relative path of a visible file on every system"


@lru_cache(maxsize=1024)  # most files of a folder have its name in common
def _is_plain_part(part: str) -> bool:
    return not (
        part.startswith(".")
        or part.endswith((".", " "))
        or leads_elsewhere(part)
        or not 0 < len(part.encode(errors="replace")) <= _LONGEST_PART_BYTES
    )


def leads_elsewhere(path: str) -> bool:
    """Return whether a path with slashes leads out of a folder, or to a drive or a device, on any system.

    Windows takes a backslash for a slash, and some names for devices, in every folder and with every ending.
    """
    return _ELSEWHERE.search(path) is not None


def names_inside(names: Iterable[object], where: str) -> tuple[str, ...]:
    """Return names of files without repetition, if each can name a file in a data set folder.

    ``where`` says in the message who gave the names. Raises IntegrityError for a name that leads out of the
    folder, is hidden, or is not valid on every system, and for two names of one file where case does not
    count.
    """
    seen: dict[str, str] = {}
    for name in names:
        problem = problem_of_name(name)
        if not problem:
            text = str(name)
            first = seen.setdefault(unicodedata.normalize("NFC", text).casefold(), text)
            problem = "" if first == text else f"is the same file as {first!r} where case does not count"
        if problem:
            raise IntegrityError(
                f"{where} names the file {shortened(ascii(name), _SHOWN)}, which {problem}; "
                "nothing was done with it",
                next="do not use this data set, or ask who made it",
            )
    return tuple(seen.values())
