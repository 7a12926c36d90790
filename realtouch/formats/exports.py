"""Exports of touches in the formats of other libraries, and the formats with a row for each touch.

Such a row has the image as it is stored, and columns that every table reader can read. If touches are clips,
a row shows one frame. A format packs the touches of a shard into its own files, and may write further files
after the last shard.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from os import PathLike
from typing import Literal, Unpack

import pyarrow as pa

from realtouch import contact, convert, touch_options
from realtouch.touches import media, rounds, stored_round
from realtouch.touches.schema import POSE_COLUMN
from tactile_toolkit import errors, kind, places, store
from tactile_toolkit.touch import MEDIA_TYPE, intact_size

ExportLayout = Literal["flat", "webdataset", "lerobot", "oxt", "replay", "fota", "anytouch"]
EXPORTS = {
    layout: kind.lazy(f"realtouch.formats.{module}:plan_{layout}")
    for layout, module in {
        "flat": "flat_parquet",
        "webdataset": "tar_samples",
        "lerobot": "lerobot_export",
        "oxt": "zarr_export",
        "replay": "zarr_export",
        "fota": "tar_samples",
        "anytouch": "media_files",
    }.items()
}

_IMAGE = "image"
_WHERE = {"seq": "frame {}: ", "single": ""}
_GROUP_BYTES = 32 << 20
_MAX_ROWS_PER_GROUP = 1 << 14
NamedImage = tuple[str, memoryview]
"""The file name of an image, and its bytes as they are stored."""
PackTouches = Callable[[store.ShardName, pa.Table, Iterator[NamedImage]], convert.Made]
"""Makes the files of a shard from the plain columns and the images of its touches; also returns an index."""


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
    plan = touch_options.require_layout(layout, EXPORTS)
    method = contact.require_method(frame)

    def planned(opened: convert.Source, limit: int | None) -> convert.Conversion:
        options = {"layout": layout, "limit": limit}
        conversion: convert.Conversion = plan(opened, convert.first_rows(opened, limit), method, options)
        return conversion

    return convert.write_conversion(source, out, planned, **job)


@dataclass(frozen=True)
class TouchFormat:
    """A format of files below ``folder``; without one, the rows are the format.

    ``pack`` makes the files of a shard, ``write_files`` those that follow from all rows. With ``no_gaps`` no
    shard may be empty, as the numbers of files have no gaps.
    """

    folder: str = ""
    pack: PackTouches | None = None
    write_files: convert.WriteFiles = convert.checksums
    no_gaps: bool = False

    def plan(
        self,
        source: convert.Source,
        choices: convert.Choices,
        method: contact.ContactMethod,
        options: Mapping[str, object],
    ) -> convert.Conversion:
        """Plan an export with a row for each touch; for clips, ``method`` chooses the frame."""
        if source.kind == "seq":
            source.require_frame(method)
            options = {**options, "frame": method}
        pack = None if self.pack is None else partial(self._pack_shard, self.pack)
        return convert.Conversion(
            source,
            "export",
            options,
            _Touches(method, source.class_names),
            convert.marked_repetitions(source, choices),
            rows_per_group=max(1, min(_MAX_ROWS_PER_GROUP, _GROUP_BYTES // source.image_bytes())),
            extra_dirs=tuple(filter(None, [self.folder])),
            write_files=self.write_files,
            pack=pack,
        )

    def _pack_shard(
        self, pack: PackTouches, shard: store.ShardName, rows: pa.Table, skipped: Sequence[store.Skipped]
    ) -> convert.Made:
        """Return the files of a shard, with the plain columns as index; an empty shard has no files."""
        index = rows.drop_columns([_IMAGE])
        if len(rows):
            return pack(shard, index, _images_of(rows[_IMAGE]))
        if self.no_gaps:
            raise errors.IntegrityError(
                f"{shard}: every round was left out, the first because {skipped[0].message}; files are "
                "numbered without gaps, so nothing of this file was written",
                next="leave it out (`realtouch select`)",
            )
        return convert.with_files(index, {})


def _images_of(column: pa.ChunkedArray) -> Iterator[NamedImage]:
    """Yield the images of a column, without copies."""
    for chunk in column.chunks:
        for path, content in zip(chunk.field("path").to_pylist(), chunk.field("bytes"), strict=True):
            yield path, memoryview(content.as_buffer()).cast("B")


@dataclass(frozen=True)
class _Touches:
    """Step of ``export``: a round becomes a row for each touch; for clips, with the frame of the contact.

    JPEGs pass through as they are stored. ``names`` are the names of the classes.
    """

    method: contact.ContactMethod
    names: tuple[str, ...]

    def schema(self, source: pa.Schema) -> pa.Schema:
        """Return the plain columns that the source can fill."""
        poses = [f"{name}.position" for name in POSE_COLUMN.values()]
        wanted: dict[str, tuple[pa.DataType, Sequence[str]]] = {
            "id": (pa.string(), ()),
            _IMAGE: (MEDIA_TYPE, ()),
            "label": (pa.int64(), ()),
            "label_name": (pa.string(), ()),
            "object_id": (pa.int64(), ("object_id",)),
            "round_id": (pa.string(), ()),
            "touch": (pa.int64(), ()),
            "frame": (pa.int64(), ()),
            **dict.fromkeys(touch_options.POSITION_COLUMNS, (pa.float64(), ("pos_in_cell",))),
            **dict.fromkeys(touch_options.POSE_COLUMNS, (pa.float64(), poses)),
        }
        return pa.schema([*convert.schema_of(source, wanted), *convert.plain_extras(source).values()])

    def apply(self, row: stored_round.StoredRound, choice: convert.RowChoice, split: str) -> convert.Made:
        """Return the touches of a round; a round with a damaged touch is left out as a whole."""
        row.label_value(self.names)
        shown = list(convert.shown_touches(row, self.method))
        columns = convert.columns_of_touches(row, shown, self.names)
        name = row.name()
        images: list[memoryview] = []
        where = _WHERE[row.kind]
        for each in shown:
            images.append(each.stored)
            try:
                intact_size(images[-1])
            except ValueError:
                with row.naming(row.media_column, each.touch, where.format(each.frame)):
                    raise
        columns["id"] = [rounds.touch_id(name, each.touch) for each in shown]
        stem = convert.stem_of_id(name)
        columns[_IMAGE] = media.image_column(images, [rounds.touch_id(stem, each.touch) for each in shown])
        return convert.table_of_columns(self.schema(row.group.table.schema), columns), {}
