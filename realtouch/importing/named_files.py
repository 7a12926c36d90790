"""Values of options of an import: frames in files, and names mapped to columns."""

from __future__ import annotations

import difflib
import io
import os
import re
from collections.abc import Iterator, Sequence
from contextlib import suppress
from pathlib import Path

import numpy as np

from realtouch.importing.import_columns import LONGEST_NAME, MAPPED, Matrix
from tactile_toolkit import errors, wording
from tactile_toolkit.arithmetic import are_rigid

_SIMILARITY = 0.8  # a name that is so similar to a known one is a misspelling of it
_LARGEST_FILE = 1 << 20  # bytes
_SEPARATORS = re.compile(r"[\[\](){},;]")


def read_frame(place: str | os.PathLike[str]) -> Matrix:
    """Read a rigid transform, 4 x 4 numbers, from a file of text, CSV, JSON or NPY.

    Raises InputError if the file cannot be read or holds no rigid transform.
    """
    content = _content_of(place)
    values: object = ()
    with suppress(ValueError, EOFError, OSError):
        if content.startswith(b"\x93NUMPY"):
            values = np.load(io.BytesIO(content), allow_pickle=False)
        else:
            words = _SEPARATORS.sub(" ", content.decode("utf-8-sig", errors="replace")).split()
            values = [list(map(float, words[start : start + 4])) for start in range(0, len(words), 4)]
    return rigid_frame(values, repr(os.fspath(place)))


def _content_of(place: str | os.PathLike[str]) -> bytes:
    """Return a small file that the user named; InputError if it cannot be read."""
    try:
        with Path(place).expanduser().open("rb") as stream:
            content = stream.read(_LARGEST_FILE + 1)
    except (OSError, ValueError) as error:
        raise errors.InputError(f"{os.fspath(place)!r} cannot be read", next="check the path") from error
    if len(content) > _LARGEST_FILE:
        raise errors.InputError(
            f"{os.fspath(place)!r} has more than {_LARGEST_FILE:,} bytes; expected a small file"
        )
    return content


def rigid_frame(values: object, where: str) -> Matrix:
    """Return a 4 x 4 matrix as tuples; InputError if it is not a rigid transform."""
    try:
        matrix = np.array(values, np.float64)
    except (TypeError, ValueError, OverflowError):
        matrix = np.empty(0)
    if matrix.shape != (4, 4):
        raise errors.InputError(f"the frame {where} is no matrix of numbers; expected 4 x 4 numbers")
    if not np.isfinite(matrix).all() or not are_rigid(matrix[None]):
        raise errors.InputError(
            f"the frame {where} is no rigid transform; expected a rotation of determinant 1, a translation, "
            "and the last row 0 0 0 1"
        )
    return tuple(map(tuple, matrix.tolist()))


def read_mapped(texts: Sequence[str]) -> dict[str, str]:
    """Return the column for each name; raises InputError as :meth:`ImportColumns.with_mapped`."""
    found: dict[str, str] = {}
    for name, column in _pairs(texts):
        if name in found:
            raise errors.InputError(f"--map names {name!r} twice; expected each name once")
        close = difflib.get_close_matches(name.lower(), (*MAPPED, *MAPPED.values()), 1, _SIMILARITY)
        if name not in MAPPED and close:
            raise errors.InputError(
                f"--map names {name!r}; expected one of {', '.join(MAPPED)}"
                f"{wording.did_you_mean(name, MAPPED)}",
                next="correct it; an extra column needs a name that is less like these",
            )
        found[name] = column
    return found


def _pairs(texts: Sequence[str]) -> Iterator[tuple[str, str]]:
    """Yield the names and columns that are stated by texts ``NAME=COLUMN`` and files of such lines."""
    for text in texts:
        lines = [text]
        where = "--map"
        if text.startswith("@"):
            where = f"--map {text}"
            content = _content_of(text[1:]).decode("utf-8-sig", errors="replace")
            lines = [
                line for line in content.splitlines() if line.strip() and not line.lstrip().startswith("#")
            ]
        for line in lines:
            name, equals, column = line.partition("=")
            if not equals or not name.strip():
                raise errors.InputError(
                    f"{where} has {line[:LONGEST_NAME]!r}; expected NAME=COLUMN, such as label=class or "
                    "pose=x,y,z,qx,qy,qz,qw"
                )
            yield name.strip(), column.strip()
