"""Further columns of touches, such as forces and temperatures, of which only the types are known."""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterator, Mapping
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc

from tactile_toolkit import errors, read, wording
from tactile_toolkit.array_types import AnyArray

_MAX_EXACT = 1 << 53  # below which float64 holds every integer


class UnknownExtraError(errors.InputError, KeyError):
    """A further column that a data set does not have; also a KeyError, as mappings raise."""

    def __init__(self, name: object, path: str, known: Collection[str]) -> None:
        found = ", ".join(map(repr, known)) or "none"
        super().__init__(
            f"{path!r} has no further column {name!r}; it has {found}"
            f"{wording.did_you_mean(str(name), known)}",
            next="name one of these, or import it again with that column",
        )
        self.args = (name, path, tuple(known))  # pickling calls the constructor with these


class Extras(Mapping[str, Any]):
    """The further columns of a round or touch, by their own names; each is read on first use.

    Numbers are arrays of their stored type. If a value of the round is missing, integers become float64
    and the value NaN, as in pandas. Texts, booleans with a missing value, and integers with a missing value
    and one of 2**53 or more, are arrays of objects, in which a missing value is None. Arrays are read-only.
    """

    __slots__ = ("_names", "_read")

    def __init__(self, names: Collection[str], read: Callable[[str], object]) -> None:
        self._names = names
        self._read = read

    def __getitem__(self, name: str) -> Any:
        """Read a column; UnknownExtraError for an unknown name."""
        return self._read(name)

    def __contains__(self, name: object) -> bool:
        return name in self._names

    def __iter__(self) -> Iterator[str]:
        return iter(self._names)

    def __len__(self) -> int:
        return len(self._names)

    def __repr__(self) -> str:
        return f"Extras({', '.join(self._names)})"


def _is_rounded(array: pa.Array) -> bool:
    """Return whether float64 does not hold all integers of an array."""
    ends = pc.min_max(array).as_py()
    return ends["min"] is not None and max(-ends["min"], ends["max"]) >= _MAX_EXACT


def array_with_gaps(array: pa.Array) -> AnyArray:
    """Return n numbers, texts or lists of them as an array with an axis for each level; see :class:`Extras`.

    Raises ValueError for lists of several lengths on a level.
    """
    if isinstance(array, pa.ExtensionArray):
        array = array.storage
    if not read.list_depth(array.type)[0]:
        if array.null_count and pa.types.is_integer(array.type) and _is_rounded(array):
            return np.array(array.to_pylist(), object)
        return read.numpy_values(array)
    present = array.drop_null()
    widths = [getattr(array.type, "list_size", 0)]
    if len(present):
        widths = np.unique(present.value_lengths()).tolist()
    if len(widths) > 1:
        raise ValueError(f"vectors of {widths[0]} and of {widths[-1]} values; expected one length")
    inner = array_with_gaps(present.flatten())
    vectors = inner.reshape(len(present), widths[0], *inner.shape[1:])
    if len(present) == len(array):
        return vectors
    values: AnyArray = np.full((len(array), *vectors.shape[1:]), None, object)
    if inner.dtype.kind in "iuf":
        values = np.full(values.shape, np.nan, inner.dtype if inner.dtype.kind == "f" else np.float64)
    values[array.is_valid().to_numpy(zero_copy_only=False)] = vectors
    values.setflags(write=False)
    return values
