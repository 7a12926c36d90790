"""Findings of a check, by which touches are left out of a selection; see :func:`realtouch.check`."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Mapping
from os import PathLike, fspath
from typing import NamedTuple

import msgspec
import numpy as np

from realtouch.touches import datasets, loading
from tactile_toolkit import errors, store
from tactile_toolkit.value_types import JsonDict

_MAX_BYTES = 1 << 28
_NEXT = "make it with `realtouch check NAME --json > findings.json`"


class _LeaveOut(msgspec.Struct):
    split: str
    row: int
    round: str
    touches: list[int] | None


class _Finding(msgspec.Struct):
    rule: str
    leave_out: list[_LeaveOut]


class _Document(msgspec.Struct):
    findings: list[_Finding]


class LeftOut(NamedTuple):
    """Touches to leave out: their numbers by split and row, and the entries of the manifest, with reasons."""

    touches: Mapping[tuple[str, int], set[int]]
    entries: list[JsonDict]


def read_findings(path: str | PathLike[str], source: loading.Source) -> LeftOut:
    """Read the document of a check of a data set; InputError if it is another one, or of another data set."""
    name = fspath(path)
    try:
        with store.open_regular(store.expanded(name)) as stream:
            document = msgspec.json.decode(stream.read(_MAX_BYTES), type=_Document)
    except (OSError, msgspec.MsgspecError) as error:
        problem = getattr(error, "strerror", None) or str(error)
        raise errors.InputError(
            f"{name!r} cannot be read as findings ({problem})", next=_NEXT, field="without"
        ) from error
    by_split = {split: datasets.dataset_of(shards) for split, shards in source.shards.items()}
    left_out: dict[tuple[str, int], set[int]] = defaultdict(set)
    entries: list[JsonDict] = []
    for finding in document.findings:
        for entry in finding.leave_out:
            if entry.split not in by_split:  # a selection may take one split
                continue
            rounds = by_split[entry.split]
            names = rounds.ids if rounds.has_column("id") else np.arange(len(rounds))
            # A round that cannot be read has no name.
            if not 0 <= entry.row < len(rounds) or entry.round not in ("", str(names[entry.row])):
                raise errors.InputError(
                    f"{name!r} names {entry.round!r} as row {entry.row} of split {entry.split!r}, which "
                    f"{source.name!r} does not have; expected findings of this data set",
                    next=_NEXT,
                    field="without",
                )
            touches = range(int(rounds.touch_counts[entry.row]))
            left_out[entry.split, entry.row] |= set(touches if entry.touches is None else entry.touches)
            entries.append({"rule": finding.rule, **msgspec.to_builtins(entry)})
    return LeftOut(left_out, entries)
