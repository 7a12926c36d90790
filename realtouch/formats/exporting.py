"""Touches in the formats of other libraries, each a module of this package."""

from __future__ import annotations

from os import PathLike
from typing import Literal, Unpack, get_args

from realtouch import contact, convert, touch_options
from tactile_toolkit import kind, places, store

ExportLayout = Literal["flat", "webdataset", "lerobot", "oxt", "replay", "fota", "anytouch"]
EXPORTS = {
    layout: kind.lazy(f"realtouch.formats.{layout}:plan_{layout}") for layout in get_args(ExportLayout)
}


def export(
    source: places.Name | places.Place,
    out: str | PathLike[str],
    layout: ExportLayout,
    *,
    frame: str = "contact_end",
    **job: Unpack[convert.JobOptions],
) -> store.Manifest:
    """Write touches in the format of another library; stored JPEGs are copied, never encoded again.

    Parameters
    ----------
    source, out, split, limit, workers, overwrite, on_progress
        As for :func:`realtouch.clips_to_images`.
    layout : str
        ``"flat"``: Parquet with a row for each touch, for `datasets`, pandas and polars. ``"webdataset"``:
        the same in tars below ``webdataset/``, an image and a JSON file for each touch. ``"lerobot"``: a
        LeRobotDataset v3.0 in ``lerobot/``, an episode for each clip, or for each round of single images,
        with depth maps if there are some; it holds one split. ``"oxt"``: Open-X-Tactile, the Zarr of
        FTP-1, with the same frames as pixels. ``"replay"``: the same frames as pixels in the Zarr group that
        Diffusion Policy reads; they need much space. ``"fota"``: the tars of T3, with poses in mm.
        ``"anytouch"``: images and list files of AnyTouch 2.
    frame : str
        Which frame of a clip a touch shows, as for :func:`realtouch.clips_to_images`; ``"lerobot"``,
        ``"oxt"`` and ``"replay"`` take all.

    Returns
    -------
    Manifest
        What the folder holds now. Damaged rounds are left out and listed in it. LeRobot numbers episodes
        without gaps, so for this format a damaged round ends the export.

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
    plan, method = touch_options.require_layout(layout, EXPORTS), contact.require_method(frame)

    def planned(opened: convert.Source, limit: int | None) -> convert.Conversion:
        options = {"layout": layout, "limit": limit}
        conversion: convert.Conversion = plan(opened, convert.first_rows(opened, limit), method, options)
        return conversion

    return convert.write_conversion(source, out, planned, **job)
