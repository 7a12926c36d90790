"""Columns of streams as arrays: one value for each sample, then one for each picture."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc

from tactile_toolkit.alignment import Neighbours
from tactile_toolkit.array_types import AnyArray, Bool
from tactile_toolkit.errors import InputError

_QUATERNION = 4
_WITH_QUATERNION = (4, 7)  # numbers of a rotation, and of a pose, that end in a quaternion


@dataclass(frozen=True, slots=True, eq=False)
class Values:
    """The values of a column, shape (m,) or (m, k), and which are missing, shape (m,)."""

    array: AnyArray
    missing: Bool

    def plain(self) -> AnyArray:
        """Return the array, where a missing value is NaN, or None if it is not a float."""
        if not self.missing.any():
            return self.array
        dtype = self.array.dtype if self.array.dtype.kind == "f" else np.dtype(object)
        found = self.array.astype(dtype)
        found[self.missing] = np.nan if dtype.kind == "f" else None
        return found

    def at(self, around: Neighbours, is_linear: bool) -> Values:
        """Return the value of each picture; on a line between samples if it is a float."""
        missing = around.missing | self.missing[around.nearest]
        if is_linear and self.array.dtype.kind == "f":
            return Values(around.interpolated(self.plain()), around.missing)
        return Values(around.picked(self.array), missing)


def values_of(column: pa.ChunkedArray, what: str) -> Values:
    """Return a column as numpy has it; InputError, which begins with ``what``, for bytes and objects.

    Numbers and switches keep their type; times and days become text; lists of one length become vectors.
    """
    values: pa.Array = column.combine_chunks()
    if isinstance(values, pa.ChunkedArray):
        values = pa.concat_arrays(values.chunks) if values.num_chunks else pa.nulls(0)
    if pa.types.is_dictionary(values.type):
        values = values.dictionary_decode()
    missing = values.is_null().to_numpy(zero_copy_only=False)
    kind = values.type
    if pa.types.is_list(kind) or pa.types.is_fixed_size_list(kind) or pa.types.is_large_list(kind):
        return Values(_vectors(values, missing, what), missing)
    if pa.types.is_decimal(kind) or pa.types.is_null(kind):
        values = values.cast(pa.float64())
    elif pa.types.is_temporal(kind):
        values = values.cast(pa.string())
    elif pa.types.is_nested(kind) or pa.types.is_binary(kind) or pa.types.is_large_binary(kind):
        raise InputError(
            f"{what} holds values of the type {kind}; expected numbers, text or lists of numbers"
        )
    if pa.types.is_integer(values.type) or pa.types.is_boolean(values.type):
        values = pc.fill_null(values, pa.scalar(0).cast(values.type))
    return Values(values.to_numpy(zero_copy_only=False), missing)


def _vectors(values: pa.Array, missing: Bool, what: str) -> AnyArray:
    """Return lists of numbers as an array, (m, k), with zeros for missing ones."""
    lengths = np.unique(pc.list_value_length(values).drop_null().to_numpy())
    inside: AnyArray = values.flatten().to_numpy(zero_copy_only=False)
    if len(lengths) != 1 or inside.dtype.kind not in "iufb":
        found = f"lists of {', '.join(map(str, lengths[:8]))} values of the type {values.type.value_type}"
        raise InputError(f"{what} holds {found}; expected lists of one number of numbers")
    vectors: AnyArray = np.zeros((len(values), int(lengths[0])), inside.dtype)
    vectors[~missing] = inside.reshape(-1, int(lengths[0]))
    return vectors


def aligned_values(
    columns: Mapping[str, Values], around: Neighbours, is_linear: bool, pose: Sequence[str]
) -> dict[str, AnyArray]:
    """Return the value of each picture in each column; those of a pose as :func:`with_streams` says."""
    found = {
        name: values.at(around, is_linear and name not in pose).plain() for name, values in columns.items()
    }
    if not is_linear or not pose or not columns.keys() >= {*pose}:
        return found
    samples = np.column_stack([columns[name].plain() for name in pose])
    if samples.shape[1] not in _WITH_QUATERNION or samples.dtype.kind not in "fiu":
        return found
    numbers = around.interpolated(samples)
    numbers[:, -_QUATERNION:] = around.turned(samples[:, -_QUATERNION:])
    numbers[around.missing] = np.nan
    if len(pose) == 1:
        return {**found, pose[0]: numbers}
    return {**found, **dict(zip(pose, numbers.T, strict=True))}
