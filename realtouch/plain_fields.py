"""Plain fields of a stored round: one value each, checked where they are read."""

from __future__ import annotations

from typing import Any

from dataset_store.records import Row
from realtouch.damage import damaged, missing_column

__all__ = ["plain_value", "stored_value"]


def plain_value(row: Row, name: str) -> Any:
    """Return a field as numpy's scalar or Python's object.

    Raises
    ------
    InputError
        The data set has no such column.
    IntegrityError
        No value is stored, or text that is no Unicode.
    """
    try:
        value = row.value(name)
    except KeyError as error:
        raise missing_column(row, name) from error
    except _unreadable():  # one such value spoils the column of its whole block
        value = stored_value(row, name)
    if value is None:
        raise damaged(row, name, "no value is stored")
    return value


def stored_value(row: Row, name: str) -> Any:
    """Return a field of any type as Python's objects, looking at no other row.

    Raises
    ------
    IntegrityError
        Text that is no Unicode is stored.
    """
    try:
        return row.group.arrow(name)[row.index].as_py()
    except _unreadable() as error:
        raise damaged(row, name, f"a value that cannot be read ({error})") from error


def _unreadable() -> tuple[type[Exception], ...]:
    # Asked for only when something was raised: the import costs nothing where all is well.
    import pyarrow as pa

    return (ValueError, pa.ArrowException)
