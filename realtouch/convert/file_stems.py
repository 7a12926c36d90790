"""Names of files for rounds: their ids, escaped."""

from __future__ import annotations

import hashlib
import re
from urllib.parse import unquote

from tactile_toolkit import store

_NOT_PLAIN = re.compile(rb"[^A-Za-z0-9_-]")
_LONGEST = 100
_KEPT = 60  # characters of a longer id, before its digest


def stem_of_id(round_id: str) -> str:
    """Return the stem of a file name for a round: its id, if that is plain.

    Characters other than letters, digits, ``-`` and ``_`` are percent-encoded, ``a.b`` as ``a%2Eb``. So
    different ids stay different, and no id leads to another folder on any system. A long id ends in its
    digest.
    """
    content = round_id.encode()
    stem = _NOT_PLAIN.sub(lambda found: b"%%%02X" % found[0][0], content).decode()
    if len(stem) > _LONGEST:
        return f"{stem[:_KEPT]}-{hashlib.sha256(content).hexdigest()[:16]}"
    if not stem or store.problem_of_name(stem):  # empty, or a device of Windows, such as ``con``
        return f"%{content[:1].hex().upper()}{stem[1:]}"
    return stem


def id_of_stem(stem: str) -> str:
    """Return the id from which :func:`stem_of_id` made a name; other names are returned unchanged."""
    round_id = unquote(stem)
    return round_id if stem_of_id(round_id) == stem else stem
