"""Names of files for rounds, whose ids may be any text."""

from __future__ import annotations

import hashlib
import re
from urllib.parse import unquote

from tactile_toolkit import store

_NOT_PLAIN = re.compile(rb"[^A-Za-z0-9_-]")
_LONGEST = 100
_KEPT = 60  # of a longer one, before its digest


def file_stem(round_id: str) -> str:
    """Return the name of a file for a round, without an ending: its id, if that is plain.

    Whatever is not a letter, a digit, ``-`` or ``_`` is escaped as in addresses, ``a.b`` as ``a%2Eb``, so
    that different ids stay different and lead nowhere else on any system; a long one ends in its digest.
    """
    content = round_id.encode()
    stem = _NOT_PLAIN.sub(_escaped, content).decode()
    if len(stem) > _LONGEST:
        return f"{stem[:_KEPT]}-{hashlib.sha256(content).hexdigest()[:16]}"
    if not stem or store.problem_of_name(stem):  # none, or a device of Windows, such as ``con``
        return f"%{content[:1].hex().upper()}{stem[1:]}"
    return stem


def id_of_stem(stem: str) -> str:
    """Return the id of which :func:`file_stem` made a name; a name that others made, as it is."""
    round_id = unquote(stem)
    return round_id if file_stem(round_id) == stem else stem


def _escaped(found: re.Match[bytes]) -> bytes:
    return f"%{found[0].hex().upper()}".encode()
