"""Writing touches in the formats of others."""

from __future__ import annotations

from collections.abc import Callable
from os import PathLike
from typing import Any, Literal

from realtouch.card import SYNTHETIC, is_synthetic
from realtouch.contact import require_method
from realtouch.convert.api import convert, first_rows
from realtouch.convert.image_files import repeated_ids
from realtouch.convert.plan import Conversion, Source
from realtouch.exchange.flat import FlatTouches
from realtouch.exchange.lerobot import lerobot_conversion
from realtouch.exchange.tars import PackTars
from realtouch.exchange.vouched import files_are_current, vouched_files
from tactile_toolkit.errors import InputError
from tactile_toolkit.run.processes import Runner
from tactile_toolkit.store.build import Progress
from tactile_toolkit.store.manifest import Manifest
from tactile_toolkit.touch.schema import class_names

__all__ = ["LAYOUTS", "export"]

LAYOUTS = ("flat", "webdataset", "lerobot")

_GROUP_BYTES = 32 << 20
_FRAMES_PER_CLIP = 64  # about; how much smaller the image of a clip is than the clip
_MOST_ROWS_PER_GROUP = 1 << 14
_TAR_BYTES = 128 << 20


def export(
    source: str | PathLike[str],
    out: str | PathLike[str],
    layout: Literal["flat", "webdataset", "lerobot"],
    *,
    frame: str = "contact_end",
    split: str | None = None,
    limit: int | None = None,
    workers: int | Runner = 1,
    overwrite: bool = False,
    on_progress: Callable[[Progress], None] = lambda _: None,
) -> Manifest:
    """Write touches in the format of another library; stored JPEGs are copied, never encoded again.

    Parameters
    ----------
    source, out, split, limit, workers, overwrite, on_progress
        As for :func:`realtouch.to_single`.
    layout : "flat", "webdataset" or "lerobot"
        ``"flat"``: Parquet with one row a touch, for `datasets`, pandas and polars. ``"webdataset"``: the
        same in tars below ``webdataset/``, an image and a JSON file for each touch. ``"lerobot"``: a
        LeRobotDataset v3.0 in ``lerobot/``, an episode for each clip, or for each round of single images; it
        holds one split.
    frame : str
        Which frame of a clip a touch of ``"flat"`` and ``"webdataset"`` shows; as for
        :func:`realtouch.to_single`. ``"lerobot"`` takes all.

    Returns
    -------
    Manifest
        What the folder holds now. Damaged rounds are left out and listed in it; LeRobot numbers episodes
        without gaps, so that there they end the export.

    Raises
    ------
    InputError
        The source or an option cannot be used, or the folder to write holds the source.
    IntegrityError
        A file of the source cannot be read, or every round is damaged.
    HubError
        The source is on the Hub and cannot be fetched.
    SpecMismatchError
        The folder holds a data set of another specification.
    StorageError
        The folder cannot be written. What was finished stays.
    """
    if layout not in LAYOUTS:
        message = f"there is no layout {layout!r}; expected {', '.join(LAYOUTS)}"
        raise InputError(message)
    method = require_method(frame)
    opened = Source.open(source, split=split)
    choices = first_rows(opened, limit)
    options: dict[str, Any] = {"layout": layout, "limit": limit}
    if opened.kind == "seq" and layout != "lerobot":
        options["frame"] = method
    if opened.kind == "single" and is_synthetic(opened.schema):
        options["touches"] = SYNTHETIC  # the terms depend on whether they were rendered
    if layout == "lerobot":
        conversion = lerobot_conversion(opened, options, choices)
    else:
        image_bytes = opened.media_bytes() // (_FRAMES_PER_CLIP if opened.kind == "seq" else 1) or 1
        rows_per_group = max(1, min(_MOST_ROWS_PER_GROUP, _GROUP_BYTES // image_bytes))
        step = FlatTouches(method, class_names(opened.schema), repeated_ids(opened, choices))
        is_flat = layout == "flat"
        conversion = Conversion(
            opened,
            "export",
            options,
            step,
            choices,
            rows_per_group=rows_per_group,
            extra_dirs=() if is_flat else ("webdataset",),
            is_current=files_are_current,
            write_files=vouched_files,
            pack=None if is_flat else PackTars(),
        )
    return convert(conversion, out, "export", workers, overwrite, on_progress)
