"""Selections: some rounds and touches of a data set, and touches that findings of a check leave out."""

from __future__ import annotations

import math
from collections import defaultdict
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from itertools import groupby
from operator import itemgetter
from os import PathLike, fspath
from typing import Unpack

import msgspec
import numpy as np
import pyarrow as pa

from realtouch.convert import conversion
from realtouch.touches import datasets, loading, schema, stored_round
from tactile_toolkit import catalog, errors, places, store, touch
from tactile_toolkit.value_types import JsonDict, JsonObject

_MAX_BYTES = 1 << 28
_NEXT = "make it with `realtouch check NAME --json > findings.json`"


def select(
    source: places.Name | places.Place,
    out: str | PathLike[str],
    *,
    contact: bool = False,
    min_height_m: float | None = None,
    recalibrate_z: bool = True,
    without: str | PathLike[str] | None = None,
    **job: Unpack[conversion.JobOptions],
) -> store.Manifest:
    """Write some rounds and touches of a data set; images and clips are copied byte for byte.

    Parameters
    ----------
    source, out, split, ids, labels, per_class, limit, workers, overwrite, on_progress
        As for :func:`clips_to_images`; ``limit`` counts the rounds that are left.
    contact : bool
        Only touches with contact, see :meth:`~realtouch.Touches.in_contact`. Rounds then differ in their
        number of touches. If heights decide, a column ``plate_z_m`` keeps the height of the plate, which
        followed from the removed touches.
    min_height_m : float, optional
        Height above the plate from which a touch counts as contact, metres; see
        :meth:`~realtouch.Touches.in_contact`.
    recalibrate_z : bool
        Take the deepest touch of each round as the plate, where its height is not known.
    without : str or path, optional
        Document of `realtouch check --json`. Touches that its findings leave out are not taken; the option
        ``without`` of the manifest lists them with the rule of each. A finding that is removed from the
        document is ignored.

    Returns
    -------
    Manifest

    Raises
    ------
    InputError, SpecMismatchError, StorageError
        As :func:`clips_to_images`; InputError, too, for findings of another data set.
    """
    if min_height_m is not None:
        min_height_m = touch.HeightRule.checked_m(min_height_m)
        if not contact:
            raise errors.InputError("has no effect without `contact`", field="min_height_m")
    touches: JsonDict = {
        "contact": contact,
        "min_height_m": min_height_m,
        "recalibrate_z": recalibrate_z,
    }
    return conversion.write_conversion(source, out, partial(_selection, touches, without), **job)


def _selection(
    touches: JsonObject,
    without: str | PathLike[str] | None,
    opened: loading.Source,
    rows: catalog.RowFilter,
) -> conversion.Conversion:
    options = {**touches}
    if not options["contact"] and without is None:
        whole = KeepTouches(some_touches=False)
        return conversion.Conversion(opened, "select", options, whole, conversion.chosen_rows(opened, rows))
    left_out: Mapping[tuple[str, int], Collection[int]] = {}
    if without is not None:
        left_out, options["without"] = _read_findings(without, opened)
    sources = opened.contact_sources
    rule = "; or ".join(map(str, sources))
    by_height = options["min_height_m"] is not None or any(source.heights for source in sources)
    choices = conversion.chosen_rows(opened, replace(rows, limit=None))
    if options["contact"]:
        if len(sources) == 1 and sources[0].heights is not None and options["min_height_m"] is None:
            options["min_height_m"] = sources[0].heights.min_height_m
        if options["min_height_m"] is None:
            options["contact_rule"] = rule
    # The limit counts rounds that are left.
    choices = {
        split: _chosen_touches(opened, split, of_split, options, left_out)[: rows.limit]
        for split, of_split in choices.items()
    }
    if any(choices.values()):
        return conversion.Conversion(opened, "select", options, KeepTouches(True, by_height), choices)
    if without is not None:
        raise errors.InputError(
            f"no chosen touch of {opened.name!r} is left without those of the findings",
            next="remove findings from the document, or give fewer filters",
        )
    if options["min_height_m"] is not None:
        raise _no_contact(opened, options["min_height_m"])
    raise errors.InputError(
        f"no chosen touch of {opened.name!r} is a contact (a touch is one if {rule})",
        next="leave out --contact, or give fewer filters",
    )


def _no_contact(source: loading.Source, height_m: float) -> errors.InputError:
    heights_m = [datasets.dataset_of(shards).touches().heights_m() for shards in source.shards.values()]
    return errors.InputError(
        f"no chosen touch of {source.name!r} is a contact (a touch is one if "
        f"{touch.HeightRule(height_m, 'known').height_text}); the highest of all touches is "
        f"{1e3 * max(of_split.max(initial=-math.inf) for of_split in heights_m):.1f} mm above it",
        next="give a smaller --min-height-mm, or fewer filters",
    )


def _chosen_touches(
    source: loading.Source,
    split: str,
    choices: Sequence[conversion.RowChoice],
    options: JsonObject,
    left_out: Mapping[tuple[str, int], Collection[int]],
) -> list[conversion.RowChoice]:
    """Return the chosen rows of a split that have touches to keep, with these touches."""
    rows = [choice.row for choice in choices]
    touches = datasets.dataset_of(source.shards[split])[rows].touches()
    if options["contact"]:
        touches = touches.with_contact(options["min_height_m"], options["recalibrate_z"])
    pairs = zip(touches.round_positions.tolist(), touches.touch_indices.tolist(), strict=True)
    kept = (pair for pair in pairs if pair[1] not in left_out.get((split, rows[pair[0]]), ()))
    return [
        conversion.RowChoice(rows[position], tuple(touch for _, touch in group))
        for position, group in groupby(kept, key=itemgetter(0))
    ]


@dataclass(frozen=True)
class KeepTouches:
    """Step of ``select``: the chosen touches of a round.

    ``by_height`` says that heights decide about contact, so that the height of the plate is kept.
    """

    some_touches: bool
    by_height: bool = False

    def schema(self, source: pa.Schema) -> pa.Schema:
        """Return the schema of the source; lists over touches get a variable length if rounds lose touches.

        The touches that showed the height of the plate may be gone.
        """
        if not self.some_touches:
            return source
        fields = list(source)
        for index, column in enumerate(source):
            if schema.is_per_touch(column.name, column.type):
                fields[index] = pa.field(column.name, pa.list_(column.type.value_type))
        if self.by_height and touch.HeightRule.PLATE_COLUMN not in source.names:
            fields.append(pa.field(touch.HeightRule.PLATE_COLUMN, pa.float64()))
        return pa.schema(fields)

    def apply(
        self, row: stored_round.StoredRound, choice: conversion.RowChoice, split: str
    ) -> conversion.Made:
        """Return a row with the chosen touches; no image or clip is decoded."""
        flat = schema.flat_row(row)
        if choice.touches is None:
            return flat, {}
        kept = schema.take_touches(flat, choice.touches, row.touch_total())
        if row.has(touch.HeightRule.PLATE_COLUMN) or not self.by_height:
            return kept, {}
        plate_m = None
        if row.has_poses:
            plate_m = row.plate_z_m(row.contact_source.heights)
            if math.isnan(plate_m):
                plate_m = row.contact_z_m().min(initial=np.inf)
        column = touch.HeightRule.PLATE_COLUMN
        values = pa.array([plate_m], pa.float64())
        if column in kept.column_names:  # it is null in rows that lacked it before sets were merged
            return kept.set_column(kept.schema.get_field_index(column), column, values), {}
        return kept.append_column(column, values), {}


class _Entry(msgspec.Struct):
    split: str
    row: int
    round: str
    touches: list[int] | None


class _Finding(msgspec.Struct):
    rule: str
    leave_out: list[_Entry]


class _Document(msgspec.Struct):
    findings: list[_Finding]


def _read_findings(
    path: str | PathLike[str], source: loading.Source
) -> tuple[Mapping[tuple[str, int], set[int]], list[JsonDict]]:
    """Read the document of a check; return the touches to leave out by split and row, and why.

    The entries for the manifest name the rule of each. Raises InputError for another document, or one of
    another data set.
    """
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
    return left_out, entries
