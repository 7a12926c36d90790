"""Selections: some rounds and touches of a data set."""

from __future__ import annotations

import math
import operator
from collections.abc import Iterable
from dataclasses import dataclass
from functools import partial
from itertools import groupby
from operator import itemgetter
from os import PathLike
from typing import SupportsIndex, Unpack

import numpy as np
import pyarrow as pa

from realtouch.convert import conversion
from realtouch.touches import datasets, image_contacts, schema, stored_round
from tactile_toolkit import catalog, errors, places, read, store, touch
from tactile_toolkit.json_types import JsonDict, JsonObject


def select(
    source: places.Name | places.Place,
    out: str | PathLike[str],
    *,
    contact: bool = False,
    min_height_m: float | None = None,
    recalibrate_z: bool = True,
    labels: Iterable[int | str] = (),
    objects: Iterable[int | tuple[int, int]] = (),
    per_class: int | None = None,
    **job: Unpack[conversion.JobOptions],
) -> store.Manifest:
    """Write some rounds and touches of a data set; images and clips are copied byte for byte.

    Parameters
    ----------
    source, out, split, workers, overwrite, on_progress
        As for :func:`clips_to_images`.
    contact : bool
        Only touches in which the gel stopped on an object, or, without poses, whose pictures show contact;
        see :meth:`~realtouch.Touches.in_contact`. Rounds then differ in their number of touches, and
        a column ``plate_z_m`` keeps the height of the plate, which followed from the removed touches.
    min_height_m : float, optional
        Height above the plate from which a touch counts as contact, metres; see
        :meth:`~realtouch.Touches.in_contact`.
    recalibrate_z : bool
        Take the deepest touch of each round as the plate, where its height is not known.
    labels : iterable of int or str
        Only these classes.
    objects : iterable of int, or of pairs of them
        Only these objects, by ``object_id``; a pair stands for all from its first to its last.
    per_class : int, optional
        Only the first ``per_class`` rounds of each class of each split.
    limit : int, optional
        Then only the first ``limit`` rounds of each split.

    Returns
    -------
    Manifest

    Raises
    ------
    InputError, SpecMismatchError, StorageError
        As :func:`clips_to_images`.
    """
    if min_height_m is not None:
        min_height_m = float(min_height_m)
    chosen: JsonDict = {
        "contact": contact,
        "min_height_m": min_height_m,
        "recalibrate_z": recalibrate_z,
        "labels": [str(label) for label in labels],
        "objects": [_object_ids(chosen_id) for chosen_id in objects],
    }
    if per_class is not None:
        chosen["per_class"] = conversion.require_limit(per_class, "per_class")
    return conversion.write_conversion(source, out, partial(_selection, chosen), **job)


def _selection(chosen: JsonObject, opened: conversion.Source, limit: int | None) -> conversion.Conversion:
    options = {**chosen, "limit": limit}
    min_height_m = options["min_height_m"]
    if min_height_m is not None and not math.isfinite(min_height_m):  # nothing is as high as NaN
        raise errors.InputError(
            f"is {min_height_m}; expected metres, such as {touch.HeightRule.REAL_M}", field="min_height_m"
        )
    by_image = options["contact"] and not schema.has_poses(read.column_types(opened.schema))
    if by_image:
        options["contact_rule"] = image_contacts.BY_IMAGE
    elif options["min_height_m"] is None:
        options["min_height_m"] = touch.HeightRule.REAL_M
        if options["contact"]:
            options["min_height_m"] = touch.HeightRule.of(read.column_types(opened.schema)).min_height_m
    choices = {of_split: _chosen_rows(opened, of_split, options) for of_split in opened.shards}
    if options["contact"] and not any(choices.values()):
        if by_image:
            raise errors.InputError(
                f"no chosen touch of {opened.name!r} is a contact (a touch is one if "
                f"{image_contacts.BY_IMAGE})",
                next="leave out --contact, or give fewer filters",
            )
        raise _no_contact(opened, options["min_height_m"])
    return conversion.Conversion(opened, "select", options, KeepTouches(options["contact"]), choices)


def _no_contact(source: conversion.Source, height_m: float) -> errors.InputError:
    heights_m = [datasets.dataset_of(shards).touches().heights_m() for shards in source.shards.values()]
    return errors.InputError(
        f"no chosen touch of {source.name!r} is a contact (a touch is one if "
        f"{touch.HeightRule(height_m, 'known').height_text}); the highest of all touches is "
        f"{1e3 * max(of_split.max(initial=-math.inf) for of_split in heights_m):.1f} mm above it",
        next="give a smaller --min-height-mm, or fewer filters",
    )


def _chosen_rows(source: conversion.Source, split: str, options: JsonObject) -> list[conversion.RowChoice]:
    """Decide which rows and touches of a split :func:`select` keeps; reads small columns only."""
    dataset = datasets.dataset_of(source.shards[split])
    limit = options["limit"]
    if (options["labels"] or "per_class" in options) and not dataset.label_names:
        raise errors.InputError(
            f"the touches of {source.name!r} have no labels, by which some could be chosen",
            next="choose by --ids, or import them again with --map label=COLUMN",
        )
    if options["labels"]:
        unknown = set(options["labels"]).difference(dataset.label_names)
        numbers = {name: int(name) for name in unknown if name.isdecimal()}
        dataset = dataset.filter_labels([numbers.get(name, name) for name in options["labels"]])
    if options["objects"]:
        if not dataset.has_column("object_id"):
            raise errors.InputError(
                f"objects is {options['objects']}, but {source.name!r} has no column 'object_id'",
                next="choose by --labels, or import it again with --map object=COLUMN",
            )
        object_ids = dataset.int_column("object_id")
        ranges = map(np.ravel, options["objects"])
        inside = [(ends[0] <= object_ids) & (object_ids <= ends[-1]) for ends in ranges]
        dataset = dataset[np.logical_or.reduce(inside).astype(bool)]
    if "per_class" in options and len(dataset):
        ((_, _, rows_kept),) = catalog.choose_rows([("", dataset)], per_class=options["per_class"])
        dataset = dataset[rows_kept]
    rows = dataset.row_numbers.tolist()
    if not options["contact"]:
        return list(map(conversion.RowChoice, rows))[:limit]
    touches = dataset.touches().with_contact(options["min_height_m"], options["recalibrate_z"])
    places = zip(touches.round_positions.tolist(), touches.touch_indices.tolist(), strict=True)
    kept = groupby(sorted(places), key=itemgetter(0))
    return [
        conversion.RowChoice(rows[position], tuple(touch for _, touch in group)) for position, group in kept
    ][:limit]


def _object_ids(value: SupportsIndex | tuple[SupportsIndex, SupportsIndex]) -> int | tuple[int, ...]:
    try:
        if isinstance(value, tuple):
            return tuple(map(operator.index, value))
        return operator.index(value)
    except TypeError as error:
        raise errors.InputError(f"objects holds {value!r}; expected integers, such as 12") from error


@dataclass(frozen=True)
class KeepTouches:
    """Step of ``select``: the chosen touches of a round."""

    some_touches: bool

    def schema(self, source: pa.Schema) -> pa.Schema:
        """Return the schema of the source; lists over touches get a variable length if rounds lose touches.

        Rounds that lose touches keep the height of their plate: the touches that showed it may be gone.
        """
        if not self.some_touches:
            return source
        fields = list(source)
        for index, field in enumerate(source):
            if schema.is_per_touch(field.name, field.type):
                fields[index] = pa.field(field.name, pa.list_(field.type.value_type))
        types = read.column_types(source)
        if touch.HeightRule.PLATE_COLUMN not in types and schema.has_poses(types):
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
        if row.has(touch.HeightRule.PLATE_COLUMN) or not row.has_poses:
            return kept, {}
        plate_m = row.plate_z_m(row.height_rule)
        if math.isnan(plate_m):
            plate_m = row.contact_z_m(row.kind).min(initial=np.inf)
        return kept.append_column(touch.HeightRule.PLATE_COLUMN, pa.array([plate_m], pa.float64())), {}
