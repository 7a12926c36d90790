"""The conversions: from clips to images, to another size, to plain files, to a selection.

Each writes a data set folder with a manifest. An interrupted one continues where it stopped; the same source
and options give byte-identical Parquet, whatever the number of workers.
"""

from __future__ import annotations

import math
import operator
from collections.abc import Callable, Iterable, Mapping
from dataclasses import replace
from itertools import chain
from os import PathLike, fspath
from typing import Any, Literal, SupportsIndex

import numpy as np

from realtouch.card import origin_of, write_card
from realtouch.contact import require_method
from realtouch.convert.pictures import IMAGE_FOLDER, INDEX_FILE, WritePictures, repeated_ids, write_index
from realtouch.convert.plan import Conversion, RowChoice, Source, plan_conversion
from realtouch.convert.steps import KeepTouches, ResizeMedia, TakeContactFrames
from realtouch.dataset import dataset_of
from realtouch.integrity.files import files_are_current
from tactile_toolkit.errors import InputError
from tactile_toolkit.read.columns import column_types
from tactile_toolkit.read.source import refuse_source
from tactile_toolkit.run.processes import Runner, runner_for
from tactile_toolkit.store.build import Progress, build
from tactile_toolkit.store.folder import DataFolder
from tactile_toolkit.store.manifest import Manifest
from tactile_toolkit.touch.contact import MIN_CONTACT_HEIGHT_M, ContactHeight, height_text
from tactile_toolkit.touch.jpeg import MAX_IMAGE_PIXELS
from tactile_toolkit.touch.schema import class_names

_CONTACT_FRAME_ROWS = 16
_INDEX_ROWS = 16


def to_single(
    source: str | PathLike[str],
    out: str | PathLike[str],
    frame: str = "contact_end",
    *,
    split: str | None = None,
    limit: int | None = None,
    workers: int | Runner = 1,
    overwrite: bool = False,
    on_progress: Callable[[Progress], None] = lambda _: None,
) -> Manifest:
    """Make a ``single`` data set of a ``seq`` one: one frame of each clip, with the pose at that moment.

    Parameters
    ----------
    source : str or path
        Data set as :func:`realtouch.load` opens it by one name; its files are fetched where they are on the
        Hub.
    out : str or path
        Folder to write, outside the source.
    frame : str
        ``"contact_end"``, ``"contact_start"``, ``"peak"``, ``"median"`` or ``"best"``; see
        :meth:`~realtouch.TouchClip.contact_index`. A clip in which ``"median"`` sees no contact gives
        its last frame of registered contact.
    split : str, optional
        Only this split, of which alone files are fetched; all by default.
    limit : int, optional
        Only the first so many rounds of each split.
    workers : int or Runner
        Number of local processes, or a runner of another kind.
    overwrite : bool
        Start again in a folder that holds another data set of this toolkit. That set comes back when the new
        one fails before its first shard is finished.
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
    IntegrityError
        A file of the source cannot be read, or every round is damaged: nothing is left behind then.
    HubError
        The source is on the Hub and cannot be fetched.
    SpecMismatchError
        The folder holds a data set of another specification.
    StorageError
        The folder cannot be written. What was finished stays.
    """
    method = require_method(frame)
    opened = Source.open(source, split=split)
    if opened.kind != "seq":
        raise InputError(f"{opened.name!r} holds single images already; expected a data set of clips (seq)")
    conversion = Conversion(
        opened,
        "to-single",
        {"frame": method, "limit": limit},
        TakeContactFrames(method),
        first_rows(opened, limit),
        rows_per_shard=_CONTACT_FRAME_ROWS,
        rows_per_group=_CONTACT_FRAME_ROWS // 2,
    )
    return convert(conversion, out, workers, overwrite, on_progress)


def resize(
    source: str | PathLike[str],
    out: str | PathLike[str],
    width: int,
    height: int,
    *,
    quality: int = 95,
    split: str | None = None,
    limit: int | None = None,
    workers: int | Runner = 1,
    overwrite: bool = False,
    on_progress: Callable[[Progress], None] = lambda _: None,
) -> Manifest:
    """Write the same data set with images or clips of another size.

    Parameters
    ----------
    source, out, split, limit, workers, overwrite, on_progress
        As for :func:`to_single`.
    width, height : int
        Size wanted, pixels. What has it already passes through byte for byte.
    quality : int
        JPEG quality of what is encoded again, 1 to 100.

    Returns
    -------
    Manifest

    Raises
    ------
    InputError, SpecMismatchError, StorageError
        As :func:`to_single`.
    """
    if width < 1 or height < 1 or width * height > MAX_IMAGE_PIXELS or not 1 <= quality <= 100:
        raise InputError(
            f"size {width} x {height} at quality {quality}; expected at least 1 x 1, at most "
            f"{MAX_IMAGE_PIXELS:,} pixels in all (4096 x 4096), and a quality of 1 to 100"
        )
    opened = Source.open(source, split=split)
    conversion = Conversion(
        opened,
        "resize",
        {"width": width, "height": height, "quality": quality, "limit": limit},
        ResizeMedia(width, height, quality),
        first_rows(opened, limit),
    )
    return convert(conversion, out, workers, overwrite, on_progress)


def select(
    source: str | PathLike[str],
    out: str | PathLike[str],
    *,
    contact: bool = False,
    min_height_m: float | None = None,
    recalibrate_z: bool = True,
    labels: Iterable[int | str] = (),
    objects: Iterable[int] = (),
    split: str | None = None,
    limit: int | None = None,
    workers: int | Runner = 1,
    overwrite: bool = False,
    on_progress: Callable[[Progress], None] = lambda _: None,
) -> Manifest:
    """Write some rounds and touches of a data set; images and clips pass through byte for byte.

    Parameters
    ----------
    source, out, split, workers, overwrite, on_progress
        As for :func:`to_single`.
    contact : bool
        Only touches in which the gel stopped on an object; rounds then differ in their number of touches, and
        a column ``plate_z_m`` keeps the height of the plate, which the touches that went have shown.
    min_height_m : float, optional
        Height above the plate from which a touch counts as contact, metres; see
        :meth:`~realtouch.touches.Touches.in_contact`.
    recalibrate_z : bool
        Take the deepest touch of each round as the plate, where its height is not known.
    labels : iterable of int or str
        Only these classes.
    objects : iterable of int
        Only these objects, by ``object_id``.
    limit : int, optional
        Only the first so many rounds of each split, of those that are left in the end.

    Returns
    -------
    Manifest

    Raises
    ------
    InputError, SpecMismatchError, StorageError
        As :func:`to_single`.
    """
    if min_height_m is not None and not math.isfinite(min_height_m):  # nothing is as high as NaN
        raise InputError(f"min_height_m is {min_height_m}; expected metres, such as {MIN_CONTACT_HEIGHT_M}")
    opened = Source.open(source, split=split)
    if min_height_m is None:
        rule = ContactHeight.of(column_types(opened.schema))
        min_height_m = rule.min_height_m if contact else MIN_CONTACT_HEIGHT_M
    options: dict[str, Any] = {
        "contact": contact,
        "min_height_m": float(min_height_m),
        "recalibrate_z": recalibrate_z,
        "labels": [str(label) for label in labels],
        "objects": [_object_id(each) for each in objects],
        "limit": _require_limit(limit),
    }
    choices = {each: _chosen_rows(opened, each, options) for each in opened.shards}
    if contact and not any(map(len, choices.values())):
        highest_m = max(
            float(dataset_of(shards, opened.kind).touches().heights_m().max(initial=-math.inf))
            for shards in opened.shards.values()
        )
        raise InputError(
            f"no touch that was chosen of {opened.name!r} counts as contact (it does where "
            f"{height_text(min_height_m)}); the highest of all touches is {1e3 * highest_m:.1f} mm above it; "
            "next: a smaller --min-height-mm, or fewer filters"
        )
    conversion = Conversion(opened, "select", options, KeepTouches(contact), choices)
    return convert(conversion, out, workers, overwrite, on_progress)


def _chosen_rows(source: Source, split: str, options: Mapping[str, Any]) -> list[RowChoice]:
    """Decide which rows and touches of a split :func:`select` keeps; reads small columns only."""
    dataset, limit = dataset_of(source.shards[split], source.kind), options["limit"]
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
        dataset = dataset[np.isin(dataset.column("object_id"), options["objects"])]
    rows = dataset.row_numbers.tolist()
    if not options["contact"]:
        return list(map(RowChoice, rows))[:limit]
    touches = dataset.touches().with_contact(options["min_height_m"], options["recalibrate_z"])
    kept: dict[int, list[int]] = {}
    for position, touch in zip(touches.round_positions.tolist(), touches.touch_indices.tolist(), strict=True):
        kept.setdefault(position, []).append(touch)
    return [RowChoice(rows[position], tuple(kept[position])) for position in sorted(kept)][:limit]


def frames(
    source: str | PathLike[str],
    out: str | PathLike[str],
    kind: Literal["png", "jpeg"] = "png",
    frame: str = "contact_end",
    *,
    difference: Literal["grey", "absolute"] | None = None,
    split: str | None = None,
    limit: int | None = None,
    workers: int | Runner = 1,
    overwrite: bool = False,
    on_progress: Callable[[Progress], None] = lambda _: None,
) -> Manifest:
    """Write touches as plain image files with an index in CSV and Parquet.

    Parameters
    ----------
    source, out, split, limit, workers, overwrite, on_progress
        As for :func:`to_single`.
    kind : "png" or "jpeg"
        Format of the files ``images/SPLIT/ROUND/TOUCH.png``. Stored JPEGs pass through byte for byte, each
        decoded once to prove that it is intact.
    frame : str
        Which frame of a clip; as for :func:`to_single`.
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
        As :func:`to_single`.
    """
    if kind not in ("png", "jpeg"):
        raise InputError(f"no picture format {kind!r}; expected png or jpeg")
    if difference not in (None, "grey", "absolute"):
        raise InputError(f"no difference {difference!r} that a picture can show; expected grey or absolute")
    method = require_method(frame)
    opened = Source.open(source, split=split)
    choices = first_rows(opened, limit)
    options: dict[str, Any] = {
        "kind": kind,
        "frame": method if opened.kind == "seq" else None,
        "limit": limit,
    }
    if difference is not None:
        options["difference"] = difference
    conversion = Conversion(
        opened,
        "frames",
        options,
        WritePictures(kind, method, difference, repeated_ids(opened, choices), class_names(opened.schema)),
        choices,
        rows_per_shard=_INDEX_ROWS,
        rows_per_group=1 << 16,
        extra_dirs=(IMAGE_FOLDER, INDEX_FILE),
        is_current=files_are_current,
        write_files=write_index,
    )
    return convert(conversion, out, workers, overwrite, on_progress)


def convert(
    conversion: Conversion,
    out: str | PathLike[str],
    workers: int | Runner,
    overwrite: bool,
    on_progress: Callable[[Progress], None],
) -> Manifest:
    """Write a conversion as a data set folder with a card; an interrupted one continues where it stopped."""
    folder = DataFolder(fspath(out))
    source = conversion.source
    refuse_source(folder, source.name, chain.from_iterable(source.shards.values()))
    origin = origin_of(source.schema, source.manifest())
    # The terms are those of the source; columns of rounds say by themselves that they were rendered.
    if origin == "imported" or (origin == "synthetic" and conversion.operation in ("frames", "export")):
        conversion = replace(conversion, options={**conversion.options, "touches": origin})
    return build(
        folder,
        plan_conversion(conversion),
        runner_for(workers),
        overwrite=overwrite,
        on_progress=on_progress,
        write_card=write_card,
    )


def first_rows(source: Source, limit: int | None) -> dict[str, list[RowChoice]]:
    """Choose the first so many rows of each split; all for None. InputError for a limit below 1."""
    most = _require_limit(limit)
    counts = {split: sum(map(len, shards)) for split, shards in source.shards.items()}
    return {split: list(map(RowChoice, range(count)[:most])) for split, count in counts.items()}


def _require_limit(limit: int | None) -> int | None:
    if limit is not None and limit < 1:
        raise InputError(f"the limit is {limit}; expected an integer of at least 1")
    return None if limit is None else operator.index(limit)


def _object_id(value: SupportsIndex) -> int:
    try:
        return operator.index(value)
    except TypeError as error:
        raise InputError(f"objects holds {value!r}; expected integers, such as 12") from error
