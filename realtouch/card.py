"""The data card of a data set of touches, converted or published."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from functools import partial
from typing import Any, Literal, TypeVar

import numpy as np

from realtouch.contact import MIN_CONTACT_HEIGHT_M
from realtouch.dataset import dataset_of
from realtouch.media.sheets import contact_sheet
from realtouch.rounds import TouchRound, TouchSeqRound, TouchSingleRound
from realtouch.touches import Touch
from tactile_toolkit.cards.card import (
    HWD_PLUS,
    TACTILE_MNIST,
    Column,
    bibtex,
    field_table,
    json_block,
    markdown_table,
    megabytes,
    picture,
    render_card,
    write_card_text,
)
from tactile_toolkit.cards.facts import FolderFacts, SplitFacts, recorded_facts
from tactile_toolkit.cards.head import card_head, head_text
from tactile_toolkit.cards.pictures import PREVIEW_FOLDER, write_previews
from tactile_toolkit.errors import ToolkitError
from tactile_toolkit.read.columns import list_depth
from tactile_toolkit.read.dataset import Row
from tactile_toolkit.store.folder import DataFolder
from tactile_toolkit.store.manifest import Manifest
from tactile_toolkit.touch.jpeg import Pixels, decode_image, encode_image
from tactile_toolkit.touch.schema import Kind, column_type, kind_of

__all__ = [
    "COLUMNS",
    "CardKind",
    "FAMILIES",
    "FRAMES",
    "INDEX_COLUMNS",
    "LIMITS",
    "PREVIEW_FILE",
    "PRINTABILITY",
    "SYNTHETIC",
    "SYNTHETIC_COLUMNS",
    "SplitFigures",
    "card_kind",
    "index_sheet",
    "is_synthetic",
    "picture_size",
    "split_figures",
    "touch_sheet",
    "write_card",
]

PREVIEW_FILE = f"{PREVIEW_FOLDER}/touches.png"

_TILES = 16
_TILE_WIDTH = 96
_ROUNDS_SEEN = 4

T = TypeVar("T")


@dataclass(frozen=True)
class SplitFigures:
    """One split in numbers; None where the data do not say.

    Attributes
    ----------
    touches : int or None
        Touches of all rounds.
    per_round : tuple of int or None
        Least and most touches of a round.
    objects : int or None
        Different objects.
    contact_share : float or None
        Share of touches that met an object.
    """

    touches: int | None
    per_round: tuple[int, int] | None
    objects: int | None
    contact_share: float | None


def split_figures(split: SplitFacts, kind: Kind) -> SplitFigures:
    """Count one split; reads small columns, no image or clip."""
    if not split.rows:
        return SplitFigures(0, None, 0, None)
    dataset = dataset_of(split.shards, kind)
    counts = _or_none(lambda: dataset.touch_counts)
    return SplitFigures(
        None if counts is None else int(counts.sum()),
        None if counts is None else (int(counts.min()), int(counts.max())),
        _or_none(lambda: len(np.unique(dataset.column("object_id")))),
        _or_none(lambda: len(dataset.touches().with_contact()) / max(len(dataset.touches()), 1)),
    )


def picture_size(facts: FolderFacts, kind: Kind) -> tuple[int, int] | None:
    """Return width and height of the first image or frame that can be read, pixels."""
    sizes = (_or_none(partial(_size, record)) for record in _first_rounds(facts, kind))
    return next((size for size in sizes if size is not None), None)


def touch_sheet(facts: FolderFacts, kind: Kind) -> bytes | None:
    """Draw up to 16 touches of the first round that can be read, as PNG; of clips, the end of contact."""
    for record in _first_rounds(facts, kind):
        images = [image for image in map(_image, _spread(record)) if image is not None]
        if images:
            return encode_image(contact_sheet(images, tile_width=_TILE_WIDTH), "png")
    return None


def index_sheet(facts: FolderFacts, folder: DataFolder) -> bytes | None:
    """Draw the first 16 pictures that an index of plain files names, as PNG."""
    shard = next((shard for split in facts.splits for shard in split.shards if len(shard)), None)
    names = [] if shard is None else shard.read(columns=["file"]).column(0).to_pylist()[:_TILES]
    images = [_or_none(partial(_stored, folder, name)) for name in names]
    whole = [image for image in images if image is not None]
    return encode_image(contact_sheet(whole, tile_width=_TILE_WIDTH), "png") if whole else None


def _stored(folder: DataFolder, name: str) -> Pixels:
    return decode_image(folder.read_bytes(name))


def _first_rounds(facts: FolderFacts, kind: Kind) -> Iterator[TouchSeqRound | TouchSingleRound]:
    """Yield the first rounds, decoding the blocks they lie in and keeping none in the cache."""
    home = TouchSingleRound if kind == "single" else TouchSeqRound
    shard = next((shard for split in facts.splits for shard in split.shards if len(shard)), None)
    if shard is None:
        return
    for count, group in enumerate(shard.blocks(0)):
        if count == _ROUNDS_SEEN:
            return
        yield home(Row(group, 0))


def _spread(record: TouchRound) -> list[Touch]:
    count = _or_none(lambda: record.touch_count) or 0
    chosen = np.unique(np.linspace(0, max(count - 1, 0), min(count, _TILES)).round().astype(int))
    return [Touch(record, int(touch)) for touch in chosen]


def _image(touch: Touch) -> Pixels | None:
    return _or_none(lambda: touch.image)


def _size(record: TouchSeqRound | TouchSingleRound) -> tuple[int, int]:
    if isinstance(record, TouchSeqRound):
        height, width = record.sensor_video[0].size
    else:
        height, width = record.sensor_image.size(0)
    return width, height


def _or_none(ask: Callable[[], T]) -> T | None:
    """Return what can be read; None where the data do not have it, or are damaged there."""
    try:
        return ask()
    except (ToolkitError, KeyError, ValueError):
        return None


_CELL = "m, cell frame"

COLUMNS: dict[str, Column] = {
    "id": ("", "name of the round, unique over all splits"),
    "label": ("", "class of the touched object"),
    "object_id": ("", "`id` of its mesh in MNIST 3D"),
    "pos_in_cell": (f"T x 2, {_CELL}", "intended positions"),
    "plate_z_m": (_CELL, "height of the plate, from all touches of the round as it was recorded"),
    "gel_pose_cell_frame.position": (f"T x 3, {_CELL}", "position of the gel at contact"),
    "gel_pose_cell_frame.quaternion": ("T x 4: x, y, z, w", "its orientation"),
    "gel_pose_cell_frame_seq.position": (
        f"T x N x 3, {_CELL}",
        "position of the gel in each frame; cut to N_i",
    ),
    "gel_pose_cell_frame_seq.quaternion": ("T x N x 4: x, y, z, w", "its orientation; cut to N_i"),
    "video_length_frames": ("T, frames", "N_i, the length of each clip"),
    "time_stamp_rel_seq": ("T x N, time since the clip's start", "time of each frame; cut to N_i"),
    "touch_start_time_rel": ("T, time since the clip's start", "first registered contact"),
    "touch_end_time_rel": ("T, time since the clip's start", "last registered contact"),
    "sensor_video": ("T clips, AVI of MJPEG frames", "what the sensor saw"),
    "sensor_image": ("T images, JPEG", "what the sensor saw at contact"),
    "info.gel_id": ("", "which gel pad was on the sensor"),
    "info.notes": ("", "notes of the recording"),
    "info.object_pose.position": (_CELL, "position of the object, for the round or for each touch"),
    "info.object_pose.quaternion": ("x, y, z, w", "its orientation"),
}

SYNTHETIC_COLUMNS: dict[str, Column] = {
    **COLUMNS,
    "object_id": ("", "`id` of the mesh of the touched object, in the data set that it comes from"),
}

FAMILIES: dict[str, Column] = {"info.": ("", "metadata of the round, as recorded")}

INDEX_COLUMNS: dict[str, Column] = {
    "id": ("", "round and touch"),
    "file": ("", "the picture, from the folder of the data set"),
    "sha256": ("hexadecimal", "checksum of the file"),
    "round_id": ("", "name of the round"),
    "touch": ("", "number of the touch in its round, from 0"),
    "frame": ("", "number of the frame in its clip, 0 for single images"),
    "label": ("", "class of the touched object"),
    "object_id": ("", "`id` of the mesh of the touched object"),
    **{f"pos_in_cell_{axis}_m": (_CELL, f"intended position, {axis}") for axis in "xy"},
    **{f"gel_{axis}_m": (_CELL, f"position of the gel, {axis}") for axis in "xyz"},
    **{f"gel_q{axis}": ("", f"orientation of the gel, quaternion's {axis}") for axis in "xyzw"},
}

FRAMES = """\
```
   cell frame, seen from above                image of the sensor

          y, away from the robot                0 ---------> column, along +x of the gel
          ^                                     |
   +------|------+                              |   18.88 x 14.16 mm of gel
   |      |      |                              |
   |      o------|--> x, right of the robot     v
   |             |                              row, along -y of the gel
   +-------------+
     z points up, out of the page
```

Cell frame: origin at the centre of the 120 x 120 mm cell; metres; right-handed. Poses are those of the gel
in this frame; quaternions are x, y, z, w. The zero of z drifts by up to 3 mm between rounds: take the
deepest touch of a round as the plate, or `plate_z_m` where that column is there."""

_COMMON = (
    "The pose of the gel is that of the arm; an object may have moved a little while it was touched.",
    "Force is estimated from the arm's joints: 5 N are not the same at every place of the cell.",
    "The gel pad was replaced halfway through the recordings; `info.gel_id`, where it is there, tells which.",
    "Many touches meet no object but the mat; filter them with `realtouch select --contact`.",
)

LIMITS: dict[str, tuple[str, ...]] = {
    "seq": (*_COMMON, "Frames are JPEG with coarser colour than brightness; decoders differ by some levels."),
    "single": (*_COMMON, "Images are JPEG; what compression lost is lost."),
    "frames": _COMMON,
    "synthetic": (
        "Rendered images lack the texture of prints, the wear of gels and the shift of objects.",
        "Touch i was rendered against the object pose of touch i - 1 in the published sets.",
        "Many touches meet no object; filter them with `realtouch select --contact`.",
    ),
}

PRINTABILITY = {
    "real": """\
`object_id` is the `id` of the touched object's mesh in its own data set: for the real touches MNIST 3D, whose
splits `printed_train` and `printed_test` were printed, and whose report tells height, walls and volume.""",
    "synthetic": """\
Nothing was printed: the objects are meshes. `object_id` is the `id` of the mesh in its data set.""",
}


CardKind = Literal["seq", "single", "synthetic", "frames"]
SYNTHETIC = "synthetic"
"""What the option ``touches`` of plain pictures says of touches that were rendered."""

_TITLES: dict[CardKind, str] = {
    "seq": "Real touches: clips",
    "single": "Real touches: single images",
    "synthetic": "Synthetic touches: single images",
    "frames": "Touches as plain pictures",
}
_RENDERED_PICTURES = "Synthetic touches as plain pictures"
_LICENCE = (
    "cc-by-2.0",
    "CC BY 2.0, as the published touches: name their authors, and say what was changed.",
)
_SYNTHETIC_LICENCE = (
    "other",
    "The terms of the published set that the touches come from; see its page on the Hub.",
)


def write_card(
    folder: DataFolder,
    manifest: Manifest | None = None,
    kind: Literal["seq", "single", "frames"] | None = None,
) -> None:
    """Write ``README.md`` of a folder of touches and the picture that it shows.

    Parameters
    ----------
    folder : DataFolder
        A converted data set, or a copy of a published one.
    manifest : Manifest, optional
        Its manifest; a copy of a published set has none, and its card says so.
    kind : "seq", "single", "frames" or None
        What it holds; told from manifest and columns where None.

    Raises
    ------
    InputError
        When the folder holds no touches.
    IntegrityError
        When a file is missing or damaged.
    StorageError
        When the folder cannot be written.
    """
    facts = recorded_facts(folder, manifest)
    told = card_kind(facts, manifest, folder.address(), kind)
    sheet = index_sheet(facts, folder) if told == "frames" else touch_sheet(facts, _stored_kind(told))
    if sheet is not None:
        write_previews(folder, {PREVIEW_FILE: sheet})
    rendered = _is_rendered(told, manifest)
    values = _values(facts, manifest, told, sheet is not None, rendered=rendered)
    head = card_head(
        facts,
        license=_licence(told, rendered)[0],
        pretty_name=values["title"],
        task_categories=["robotics", "image-classification"],
        task_ids=["multi-class-image-classification"],
        tags=["tactile", "active-perception", "gelsight", "touch", *_tags(told, rendered)],
    )
    write_card_text(folder, head_text(head) + "\n" + render_card(f"touch_{told}.md", values))


def card_kind(facts: FolderFacts, manifest: Manifest | None, where: str, kind: str | None = None) -> CardKind:
    """Tell which card a folder gets.

    Raises
    ------
    InputError
        When the folder holds no touches.
    """
    if kind == "frames" or (manifest is not None and manifest.spec.get("operation") == "frames"):
        return "frames"
    stored = kind_of(facts.schema, where)
    return "synthetic" if stored == "single" and is_synthetic(facts.schema) else stored


def is_synthetic(schema: Any) -> bool:
    """Tell rendered touches from recorded ones: they have a pose of the object for each touch."""
    pose = column_type(schema, "info.object_pose.position")
    return pose is not None and list_depth(pose)[0] == 2


def _is_rendered(kind: CardKind, manifest: Manifest | None) -> bool:
    """Tell whether the touches were rendered; of plain pictures the manifest alone knows."""
    options = {} if manifest is None else manifest.spec.get("options", {})
    return kind == "synthetic" or (kind == "frames" and options.get("touches") == SYNTHETIC)


def _stored_kind(kind: CardKind) -> Literal["seq", "single"]:
    return "seq" if kind == "seq" else "single"


def _values(
    facts: FolderFacts, manifest: Manifest | None, kind: CardKind, drawn: bool, *, rendered: bool
) -> dict[str, str]:
    figures = [] if kind == "frames" else [split_figures(split, _stored_kind(kind)) for split in facts.splits]
    size = None if kind == "frames" else picture_size(facts, _stored_kind(kind))
    columns = INDEX_COLUMNS if kind == "frames" else SYNTHETIC_COLUMNS if rendered else COLUMNS
    return {
        "title": _RENDERED_PICTURES if rendered and kind == "frames" else _TITLES[kind],
        "rows": f"{facts.rows:,}",
        "rounds": f"{facts.rows:,}",
        "touches": _total([figure.touches for figure in figures]),
        "size_text": f", {size[0]} x {size[1]} pixels" if size else "",
        "picture": picture(PREVIEW_FILE if drawn else None, "Some touches, each at contact"),
        "made": _made(manifest),
        "split_table": _split_table(facts, figures, manifest),
        "contact_mm": f"{1e3 * MIN_CONTACT_HEIGHT_M:g}",
        "field_table": field_table(facts, columns, FAMILIES),
        "frames": FRAMES,
        "limits": "\n".join(f"- {line}" for line in LIMITS["synthetic" if rendered else kind]),
        "printability": PRINTABILITY["synthetic" if rendered else "real"],
        "first_split": facts.splits[0].split,
        "licence_text": _licence(kind, rendered)[1],
        "citation_text": _citation_text(rendered),
        "bibtex": bibtex(TACTILE_MNIST, *(() if rendered else (HWD_PLUS,))),
    }


def _licence(kind: CardKind, rendered: bool) -> tuple[str, str]:
    if rendered:
        return _SYNTHETIC_LICENCE
    if kind == "frames":
        return _LICENCE[0], "That of the touches: CC BY 2.0 for the published real ones; name their authors."
    return _LICENCE


def _tags(kind: CardKind, rendered: bool) -> list[str]:
    if rendered:
        return ["synthetic"]
    return ["mnist", "digits", "video"] if kind == "seq" else ["mnist", "digits"]


def _total(counts: list[int | None]) -> str:
    known = [count for count in counts if count is not None]
    return f"{sum(known):,}" if len(known) == len(counts) else "an unknown number of"


def _made(manifest: Manifest | None) -> str:
    if manifest is None:
        return (
            "Not made by this toolkit: the folder has no `manifest.json`, and its files are described as "
            "they are. The schema is that of the data sets that the authors of the paper published."
        )
    source = manifest.spec["source"]
    files = ", ".join(f"{split}: {len(names)}" for split, names in source.items())
    rows = ", ".join(f"{split}: {sum(file['rows'] for file in names):,}" for split, names in source.items())
    lines = [
        ("made by", f"tactile-toolkit {manifest.toolkit_version} (schema {manifest.schema_version})"),
        ("command", f"`realtouch {manifest.spec['operation']}`"),
        ("source", f"files {files}; rounds {rows}; `manifest.json` names and fingerprints each file"),
        ("rounds left out", _skipped(manifest)),
    ]
    return markdown_table(("", ""), lines) + "\n\nOptions:\n\n" + json_block(manifest.spec["options"])


def _skipped(manifest: Manifest) -> str:
    reasons = manifest.skipped_reasons()
    listed = ", ".join(f"{count:,} {reason}" for reason, count in reasons.items())
    return f"{listed}; `manifest.json` names each" if reasons else "none"


def _split_table(facts: FolderFacts, figures: list[SplitFigures], manifest: Manifest | None) -> str:
    left_out = {} if manifest is None else manifest.split_table()
    sizes = [
        (len(split.paths), megabytes(split.file_bytes), megabytes(split.unpacked_bytes))
        for split in facts.splits
    ]
    if not figures:
        rows = [(s.split, f"{s.rows:,}", *size) for s, size in zip(facts.splits, sizes, strict=True)]
        return markdown_table(("split", "pictures", "shards", "Parquet", "unpacked"), rows)
    header = ("split", "rounds", "touches", "per round", "objects", "contact", "left out")
    counted = [
        (s.split, f"{s.rows:,}", *_figures(figure), _left_out(left_out, s.split), *size)
        for s, figure, size in zip(facts.splits, figures, sizes, strict=True)
    ]
    return markdown_table((*header, "shards", "Parquet", "unpacked"), counted)


def _left_out(table: Mapping[str, Mapping[str, Any]], split: str) -> str:
    return str(table[split]["skipped"]) if split in table else "-"


def _figures(figures: SplitFigures) -> tuple[str, str, str, str]:
    least, most = figures.per_round or (0, 0)
    return (
        _counted(figures.touches),
        "-" if figures.per_round is None else f"{most:,}" if least == most else f"{least:,} to {most:,}",
        _counted(figures.objects),
        "-" if figures.contact_share is None else f"{100 * figures.contact_share:.1f} %",
    )


def _counted(count: int | None) -> str:
    return "-" if count is None else f"{count:,}"


def _citation_text(rendered: bool) -> str:
    if rendered:
        return "The touches: Schneider et al. 2025."
    return (
        "The touches and the digits: Schneider et al. 2025. The digits were made from the handwriting of "
        "HWD+ (Beaulac and Rosenthal 2022)."
    )
