"""Selections: some rounds and touches of a data set."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial
from itertools import groupby
from operator import itemgetter
from os import PathLike
from typing import Unpack

import numpy as np
import pyarrow as pa

from realtouch.convert import conversion
from realtouch.touches import datasets, loading, schema, stored_round
from tactile_toolkit import catalog, checked_fields, errors, places, read, store, touch
from tactile_toolkit.value_types import JsonDict, JsonObject


def select(
    source: places.Name | places.Place,
    out: str | PathLike[str],
    *,
    contact: bool = False,
    min_height_m: float | None = None,
    recalibrate_z: bool = True,
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

    Returns
    -------
    Manifest

    Raises
    ------
    InputError, SpecMismatchError, StorageError
        As :func:`clips_to_images`.
    """
    if min_height_m is not None:
        min_height_m = checked_fields.checked_number(min_height_m, "min_height_m")
        if not contact:
            raise errors.InputError("has no effect without `contact`", field="min_height_m")
    touches: JsonDict = {
        "contact": contact,
        "min_height_m": min_height_m,
        "recalibrate_z": recalibrate_z,
    }
    return conversion.write_conversion(source, out, partial(_selection, touches), **job)


def _selection(touches: JsonObject, opened: loading.Source, rows: catalog.RowFilter) -> conversion.Conversion:
    options = {**touches}
    if not options["contact"]:
        whole = KeepTouches(some_touches=False)
        return conversion.Conversion(opened, "select", options, whole, conversion.chosen_rows(opened, rows))
    contact_source = schema.ContactSource.of(read.column_types(opened.schema))
    if contact_source.heights is not None and options["min_height_m"] is None:
        options["min_height_m"] = contact_source.heights.min_height_m
    by_height = options["min_height_m"] is not None
    if not by_height:
        options["contact_rule"] = str(contact_source)
    # The limit counts rounds with contact.
    choices = {
        split: _with_contact(opened, split, choices, options)[: rows.limit]
        for split, choices in conversion.chosen_rows(opened, replace(rows, limit=None)).items()
    }
    if not any(choices.values()):
        if by_height:
            raise _no_contact(opened, options["min_height_m"])
        raise errors.InputError(
            f"no chosen touch of {opened.name!r} is a contact (a touch is one if {contact_source})",
            next="leave out --contact, or give fewer filters",
        )
    return conversion.Conversion(opened, "select", options, KeepTouches(True, by_height), choices)


def _no_contact(source: loading.Source, height_m: float) -> errors.InputError:
    heights_m = [datasets.dataset_of(shards).touches().heights_m() for shards in source.shards.values()]
    return errors.InputError(
        f"no chosen touch of {source.name!r} is a contact (a touch is one if "
        f"{touch.HeightRule(height_m, 'known').height_text}); the highest of all touches is "
        f"{1e3 * max(of_split.max(initial=-math.inf) for of_split in heights_m):.1f} mm above it",
        next="give a smaller --min-height-mm, or fewer filters",
    )


def _with_contact(
    source: loading.Source, split: str, choices: Sequence[conversion.RowChoice], options: JsonObject
) -> list[conversion.RowChoice]:
    """Return the chosen rows of a split that have touches with contact, with these touches."""
    rows = [choice.row for choice in choices]
    touches = datasets.dataset_of(source.shards[split])[rows].touches()
    touches = touches.with_contact(options["min_height_m"], options["recalibrate_z"])
    pairs = zip(touches.round_positions.tolist(), touches.touch_indices.tolist(), strict=True)
    return [
        conversion.RowChoice(rows[position], tuple(touch for _, touch in group))
        for position, group in groupby(pairs, key=itemgetter(0))
    ]


@dataclass(frozen=True)
class KeepTouches:
    """Step of ``select``: the chosen touches of a round; ``by_height`` says that their heights chose them."""

    some_touches: bool
    by_height: bool = False

    def schema(self, source: pa.Schema) -> pa.Schema:
        """Return the schema of the source; lists over touches get a variable length if rounds lose touches.

        Rounds that lose touches by their heights keep the height of their plate: the touches that showed it
        may be gone.
        """
        if not self.some_touches:
            return source
        fields = list(source)
        for index, field in enumerate(source):
            if schema.is_per_touch(field.name, field.type):
                fields[index] = pa.field(field.name, pa.list_(field.type.value_type))
        if self.by_height and touch.HeightRule.PLATE_COLUMN not in read.column_types(source):
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
        plate_m = row.plate_z_m(row.contact_source.heights)
        if math.isnan(plate_m):
            plate_m = row.contact_z_m(row.kind).min(initial=np.inf)
        return kept.append_column(touch.HeightRule.PLATE_COLUMN, pa.array([plate_m], pa.float64())), {}
