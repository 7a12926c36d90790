"""Writing touches in the formats of others."""

from __future__ import annotations

from collections.abc import Callable
from os import PathLike
from typing import Literal

from realtouch.contact import require_method
from realtouch.convert.api import convert, first_rows
from realtouch.convert.plan import Source
from realtouch.exchange.formats import EXPORTS, format_of
from tactile_toolkit.run.processes import Runner
from tactile_toolkit.store.build import Progress
from tactile_toolkit.store.manifest import Manifest


def export(
    source: str | PathLike[str],
    out: str | PathLike[str],
    layout: Literal["flat", "webdataset", "lerobot", "replay", "fota", "sparsh", "anytouch"],
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
    layout : str
        ``"flat"``: Parquet with one row a touch, for `datasets`, pandas and polars. ``"webdataset"``: the
        same in tars below ``webdataset/``, an image and a JSON file for each touch. ``"lerobot"``: a
        LeRobotDataset v3.0 in ``lerobot/``, an episode for each clip, or for each round of single images; it
        holds one split. ``"replay"``: the same frames as pixels in the Zarr group that Diffusion Policy
        reads, for sets that fit on a disk so. ``"fota"``: the tars of T3, poses in mm. ``"sparsh"``: pickled
        lists of encoded images, with a background. ``"anytouch"``: images and list files of AnyTouch 2.
    frame : str
        Which frame of a clip a touch shows, as for :func:`realtouch.to_single`; ``"lerobot"`` and
        ``"replay"`` take all.

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
    plan = format_of(EXPORTS, layout)
    method = require_method(frame)
    opened = Source.open(source, split=split)
    options = {"layout": layout, "limit": limit}
    conversion = plan(opened, first_rows(opened, limit), method, options)
    return convert(conversion, out, workers, overwrite, on_progress)
