"""The conversions: from clips to images, to another size, to plain files, to a selection.

Each writes a data set folder with a manifest. An interrupted one continues where it stopped; the same source
and options give byte-identical Parquet, whatever the number of workers.
"""

from __future__ import annotations

import math
import operator
from collections.abc import Iterable, Mapping
from functools import partial
from os import PathLike
from typing import Any, Literal, SupportsIndex, Unpack

import numpy as np

from realtouch.contact import require_method
from realtouch.convert.plan import (
    Conversion,
    JobOptions,
    RowChoice,
    Source,
    convert,
    first_rows,
    marked_repetitions,
    require_limit,
)
from realtouch.convert.steps import (
    IMAGE_FOLDER,
    INDEX_FILE,
    KeepTouches,
    ResizeMedia,
    TakeContactFrames,
    WritePictures,
    write_index,
)
from realtouch.dataset import dataset_of
from tactile_toolkit.catalog.choose import choose_rows
from tactile_toolkit.errors import InputError
from tactile_toolkit.read.columns import class_names, column_types
from tactile_toolkit.store.manifest import Manifest
from tactile_toolkit.touch.contact import MIN_CONTACT_HEIGHT_M, ContactHeight, height_text
from tactile_toolkit.touch.jpeg import MAX_IMAGE_PIXELS
from tactile_toolkit.touch.schema import CLASS_NAMES

_CONTACT_FRAME_ROWS = 16
_INDEX_ROWS = 16


def clips_to_images(
    source: str | PathLike[str],
    out: str | PathLike[str],
    frame: str = "contact_end",
    **job: Unpack[JobOptions],
) -> Manifest:
    """Make a ``single`` data set of a ``seq`` one: one frame of each clip, with the pose at that moment.

    Parameters
    ----------
    source : str or path
        Data set as :func:`realtouch.load` opens it by one name.
    out : str or path
        Folder to write, outside the source.
    frame : str
        ``"contact_end"``, ``"contact_start"``, ``"peak"`` or ``"best"``; see
        :meth:`~realtouch.TouchClip.contact_index`.
    split : str, optional
        Only this split, of which alone files are fetched; all by default.
    limit : int, optional
        Only the first ``limit`` rounds of each split.
    workers : int or Runner
        Number of local processes, 1 by default, or a runner of another kind.
    overwrite : bool
        Replace another data set of this toolkit in the folder.
    on_progress : callable
        Called after each shard.

    Returns
    -------
    Manifest
        What the folder holds now; rounds that are damaged are left out and listed in it.

    Raises
    ------
    InputError
        The source or an option cannot be used, or the folder to write holds the source.
    IntegrityError, HubError
        A file of the source cannot be read or fetched, or every round is damaged.
    SpecMismatchError, StorageError
        The folder holds a data set of another specification, or cannot be written: what was finished stays.
    """
    method = require_method(frame)

    def plan(opened: Source, limit: int | None) -> Conversion:
        if opened.kind != "seq":
            raise InputError(
                f"{opened.name!r} holds single images already; expected a data set of clips (seq)"
            )
        return Conversion(
            opened,
            "to-single",
            {"frame": method, "limit": limit},
            TakeContactFrames(method),
            first_rows(opened, limit),
            rows_per_shard=_CONTACT_FRAME_ROWS,
            rows_per_group=_CONTACT_FRAME_ROWS // 2,
        )

    return convert(source, out, plan, **job)


def resize(
    source: str | PathLike[str],
    out: str | PathLike[str],
    width: int,
    height: int,
    *,
    quality: int = 95,
    **job: Unpack[JobOptions],
) -> Manifest:
    """Write the same data set with images or clips of another size.

    Parameters
    ----------
    source, out, split, limit, workers, overwrite, on_progress
        As for :func:`clips_to_images`.
    width, height : int
        Size wanted, pixels. What has it already passes through byte for byte.
    quality : int
        JPEG quality of images that are encoded again, 1 to 100.

    Returns
    -------
    Manifest

    Raises
    ------
    InputError, SpecMismatchError, StorageError
        As :func:`clips_to_images`.
    """
    if width < 1 or height < 1 or width * height > MAX_IMAGE_PIXELS or not 1 <= quality <= 100:
        raise InputError(
            f"size {width} x {height} at quality {quality}; expected at least 1 x 1, at most "
            f"{MAX_IMAGE_PIXELS:,} pixels in all (4096 x 4096), and a quality of 1 to 100"
        )

    def plan(opened: Source, limit: int | None) -> Conversion:
        options = {"width": width, "height": height, "quality": quality, "limit": limit}
        step = ResizeMedia(width, height, quality)
        return Conversion(opened, "resize", options, step, first_rows(opened, limit))

    return convert(source, out, plan, **job)


def select(
    source: str | PathLike[str],
    out: str | PathLike[str],
    *,
    contact: bool = False,
    min_height_m: float | None = None,
    recalibrate_z: bool = True,
    labels: Iterable[int | str] = (),
    objects: Iterable[int | tuple[int, int]] = (),
    per_class: int | None = None,
    **job: Unpack[JobOptions],
) -> Manifest:
    """Write some rounds and touches of a data set; images and clips pass through byte for byte.

    Parameters
    ----------
    source, out, split, workers, overwrite, on_progress
        As for :func:`clips_to_images`.
    contact : bool
        Only touches in which the gel stopped on an object; rounds then differ in their number of touches, and
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
    if min_height_m is not None and not math.isfinite(min_height_m):  # nothing is as high as NaN
        raise InputError(f"min_height_m is {min_height_m}; expected metres, such as {MIN_CONTACT_HEIGHT_M}")
    chosen: dict[str, Any] = {
        "contact": contact,
        "min_height_m": None if min_height_m is None else float(min_height_m),
        "recalibrate_z": recalibrate_z,
        "labels": [str(label) for label in labels],
        "objects": [_object_ids(each) for each in objects],
        **({} if require_limit(per_class, "per_class") is None else {"per_class": per_class}),
    }
    return convert(source, out, partial(_selection, chosen), **job)


def _selection(chosen: Mapping[str, Any], opened: Source, limit: int | None) -> Conversion:
    options = {**chosen, "limit": limit}
    if options["min_height_m"] is None:
        rule = ContactHeight.of(column_types(opened.schema))
        options["min_height_m"] = rule.min_height_m if options["contact"] else MIN_CONTACT_HEIGHT_M
    choices = {each: _chosen_rows(opened, each, options) for each in opened.shards}
    if options["contact"] and not any(choices.values()):
        raise _no_contact(opened, options["min_height_m"])
    return Conversion(opened, "select", options, KeepTouches(options["contact"]), choices)


def _no_contact(source: Source, height_m: float) -> InputError:
    heights_m = [dataset_of(shards).touches().heights_m() for shards in source.shards.values()]
    return InputError(
        f"no touch that was chosen of {source.name!r} counts as contact (it does where "
        f"{height_text(height_m)}); the highest of all touches is "
        f"{1e3 * max(each.max(initial=-math.inf) for each in heights_m):.1f} mm above it",
        next="a smaller --min-height-mm, or fewer filters",
    )


def _chosen_rows(source: Source, split: str, options: Mapping[str, Any]) -> list[RowChoice]:
    """Decide which rows and touches of a split :func:`select` keeps; reads small columns only."""
    dataset, limit = dataset_of(source.shards[split]), options["limit"]
    if options["labels"]:
        known = dataset.label_names
        dataset = dataset.filter_labels(
            [name if name in known or not name.isdecimal() else int(name) for name in options["labels"]]
        )
    if options["objects"]:
        if not dataset.has_column("object_id"):
            raise InputError(
                f"objects is {options['objects']}, but {source.name!r} has no column 'object_id'",
                next="choose by --labels, or import it again with --object-column",
            )
        numbers = dataset.int_column("object_id")
        ranges = (each if isinstance(each, tuple) else (each, each) for each in options["objects"])
        inside = [(low <= numbers) & (numbers <= high) for low, high in ranges]
        dataset = dataset[np.logical_or.reduce(inside).astype(bool)]
    if "per_class" in options and len(dataset):
        ((_, _, rows_kept),) = choose_rows([("", dataset)], per_class=options["per_class"])
        dataset = dataset[rows_kept]
    rows = dataset.row_numbers.tolist()
    if not options["contact"]:
        return list(map(RowChoice, rows))[:limit]
    touches = dataset.touches().with_contact(options["min_height_m"], options["recalibrate_z"])
    kept: dict[int, list[int]] = {}
    for position, touch in zip(touches.round_positions.tolist(), touches.touch_indices.tolist(), strict=True):
        kept.setdefault(position, []).append(touch)
    return [RowChoice(rows[position], tuple(kept[position])) for position in sorted(kept)][:limit]


def _object_ids(value: SupportsIndex | tuple[SupportsIndex, SupportsIndex]) -> int | tuple[int, ...]:
    try:
        return tuple(map(operator.index, value)) if isinstance(value, tuple) else operator.index(value)
    except TypeError as error:
        raise InputError(f"objects holds {value!r}; expected integers, such as 12") from error


def frames(
    source: str | PathLike[str],
    out: str | PathLike[str],
    kind: Literal["png", "jpeg"] = "png",
    frame: str = "contact_end",
    *,
    difference: Literal["grey", "absolute"] | None = None,
    **job: Unpack[JobOptions],
) -> Manifest:
    """Write touches as plain image files with an index in CSV and Parquet.

    Parameters
    ----------
    source, out, split, limit, workers, overwrite, on_progress
        As for :func:`clips_to_images`.
    kind : "png" or "jpeg"
        Format of the files ``images/SPLIT/ROUND/TOUCH.png``. Stored JPEGs pass through byte for byte, each
        decoded once to prove that it is intact.
    frame : str
        Which frame of a clip; as for :func:`clips_to_images`.
    difference : "grey" or "absolute", optional
        Write what differs from the background, as :func:`realtouch.difference` gives it, instead of the
        picture: from the median of the clip, or of the images of the round.

    Returns
    -------
    Manifest
        Each file is named in ``index.csv`` with its checksum, label, position and pose. A round whose id is
        no file name, or stands in a round before it, is left out like a damaged one.

    Raises
    ------
    InputError, SpecMismatchError, StorageError
        As :func:`clips_to_images`.
    """
    if kind not in ("png", "jpeg"):
        raise InputError(f"no picture format {kind!r}; expected png or jpeg")
    if difference not in (None, "grey", "absolute"):
        raise InputError(f"no difference {difference!r} that a picture can show; expected grey or absolute")
    method = require_method(frame)

    def plan(opened: Source, limit: int | None) -> Conversion:
        options = {"kind": kind, "frame": method if opened.kind == "seq" else None, "limit": limit}
        return Conversion(
            opened,
            "frames",
            {**options, **({} if difference is None else {"difference": difference})},
            WritePictures(kind, method, difference, class_names(opened.schema, CLASS_NAMES)),
            marked_repetitions(opened, first_rows(opened, limit)),
            rows_per_shard=_INDEX_ROWS,
            rows_per_group=1 << 16,
            extra_dirs=(IMAGE_FOLDER, INDEX_FILE),
            write_files=write_index,
        )

    return convert(source, out, plan, **job)
