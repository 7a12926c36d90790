"""Further columns of touches, of which this toolkit knows nothing but their types: forces, temperatures."""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterator, Mapping
from typing import Any

import numpy as np
import pyarrow as pa

from tactile_toolkit import read
from tactile_toolkit.array_types import AnyArray, Bool
from tactile_toolkit.errors import InputError
from tactile_toolkit.wording import did_you_mean


class UnknownExtraError(InputError, KeyError):
    """A further column that a data set does not have; a KeyError, as of every mapping."""

    def __init__(self, name: object, path: str, known: Collection[str]) -> None:
        found = ", ".join(map(repr, known)) or "none"
        super().__init__(
            f"{path!r} has no further column {name!r}; it has {found}{did_you_mean(str(name), known)}",
            next="name one of these, or import it again with that column",
        )
        self.args = (name, path, tuple(known))  # by which it crosses process borders


class Extras(Mapping[str, Any]):
    """The further columns of a round or touch, by their own names; each is read when it is asked for.

    Numbers are arrays of their stored type. If a value of the round is missing, integers are float64 as in
    pandas, and NaN stands in its place. Texts, and booleans of which one is missing, are arrays of objects
    with None in its place. Arrays are read-only.
    """

    __slots__ = ("_names", "_read")

    def __init__(self, names: Collection[str], read: Callable[[str], Any]) -> None:
        self._names = names
        self._read = read

    def __getitem__(self, name: str) -> Any:
        """Read a column. Raises KeyError, an InputError too, for an unknown name."""
        return self._read(name)

    def __contains__(self, name: object) -> bool:
        return name in self._names

    def __iter__(self) -> Iterator[str]:
        return iter(self._names)

    def __len__(self) -> int:
        return len(self._names)

    def __repr__(self) -> str:
        return f"Extras({', '.join(self._names)})"


def array_with_gaps(array: pa.Array) -> AnyArray:
    """Return n numbers, texts or vectors of k of them, shape (n,) or (n, k); see :class:`Extras`.

    Raises ValueError for vectors of several lengths.
    """
    if not read.list_depth(array.type)[0]:
        return read.numpy_values(array)
    present = array.is_valid().to_numpy(zero_copy_only=False)
    flat = read.numpy_values(array.flatten())  # missing vectors have no values
    width = _vector_length(array, present)
    vectors = flat.reshape(int(present.sum()), width)
    if present.all():
        return vectors
    if flat.dtype.kind in "iuf":
        dtype = flat.dtype if flat.dtype.kind == "f" else np.float64
        values: AnyArray = np.full((len(array), width), np.nan, dtype)
    else:
        values = np.full((len(array), width), None, object)
    values[present] = vectors
    values.setflags(write=False)
    return values


def _vector_length(array: pa.Array, present: Bool) -> int:
    """Return the length of all vectors that are not missing; ValueError if there are several."""
    if pa.types.is_fixed_size_list(array.type):
        return int(array.type.list_size)
    lengths = np.unique(np.diff(read.numpy_values(array.offsets))[present]).tolist()
    if len(lengths) > 1:
        raise ValueError(f"vectors of {lengths[0]} and of {lengths[-1]} values; expected one length")
    return lengths[0] if lengths else 0
