"""The data card of a data set of touches, converted or published."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from itertools import islice
from operator import attrgetter
from typing import Any, Literal, TypeVar

import numpy as np

from realtouch.dataset import dataset_of
from realtouch.exported_card import EXPORTS, ExportText
from realtouch.kind import KIND
from realtouch.media.sheets import contact_sheet, evenly_spaced
from realtouch.rounds import TouchSeqRound, TouchSingleRound
from realtouch.touch import Touch
from tactile_toolkit.cards.card import (
    Column,
    between,
    bibtex,
    field_table,
    json_block,
    made_by,
    markdown_table,
    megabytes,
    skipped_text,
    write_card_files,
)
from tactile_toolkit.cards.facts import FolderFacts, SplitFacts, folder_facts
from tactile_toolkit.errors import ToolkitError
from tactile_toolkit.pictures.writing import png_bytes
from tactile_toolkit.printable import markdown_text
from tactile_toolkit.read.columns import column_types, list_depth
from tactile_toolkit.read.dataset import Row
from tactile_toolkit.read.parquet import Shard
from tactile_toolkit.store.folder import DataFolder
from tactile_toolkit.store.manifest import Manifest
from tactile_toolkit.touch.contact import ContactHeight, missed_text
from tactile_toolkit.touch.jpeg import Pixels, decode_image
from tactile_toolkit.touch.schema import Kind, column_type, kind_of

__all__ = ["COLUMNS", "IMPORTED", "SYNTHETIC", "is_imported", "is_synthetic", "write_card"]

_TILES = 16
_TILE_WIDTH = 96
# Each is a block to unpack: of a damaged set a card should not try them all.
_ROUNDS_SEEN = 4

T = TypeVar("T")


@dataclass(frozen=True)
class _SplitFigures:
    """One split in numbers; None where the data do not say."""

    touches: int | None
    per_round: tuple[int, int] | None  # least and most touches
    objects: int | None
    contact_share: float | None


def _split_figures(split: SplitFacts, kind: Kind) -> _SplitFigures:
    """Count one split; reads small columns, no image or clip."""
    if not split.rows:
        return _SplitFigures(0, None, 0, None)
    dataset = dataset_of(split.shards, kind)
    counts = _or_none(lambda: dataset.touch_counts)
    return _SplitFigures(
        None if counts is None else int(counts.sum()),
        None if counts is None else (int(counts.min()), int(counts.max())),
        _or_none(lambda: len(np.unique(dataset.column("object_id")))),
        _or_none(lambda: float(dataset.touches().in_contact().mean())),
    )


def _picture_size(facts: FolderFacts, kind: Kind) -> tuple[int, int] | None:
    """Return width and height of the first image or frame that can be read, pixels."""
    sizes = (_or_none(record._picture_size, 0) for record in _first_rounds(facts, kind))
    return next((size for size in sizes if size is not None), None)


def _sheet(facts: FolderFacts, folder: DataFolder, card: _CardKind, stored: Kind) -> bytes | None:
    """Draw the first 16 pictures that can be read, as PNG; of clips, the end of contact."""
    if card not in _PLAIN:
        for record in _first_rounds(facts, stored):
            count = _or_none(attrgetter("touch_count"), record) or 0
            touches = [Touch(record, touch) for touch in evenly_spaced(count, _TILES)]
            drawn = _drawn(_or_none(attrgetter("image"), touch) for touch in touches)
            if drawn is not None:
                return drawn
        return None
    shard = _first_shard(facts)
    if shard is None:
        return None
    if card == "frames":
        names = shard.read(columns=["file"]).column(0).to_pylist()[:_TILES]
        return _drawn(_or_none(lambda name: decode_image(folder.read_bytes(name)), name) for name in names)
    if "image.bytes" not in shard.types:  # an index of tars, or of files of LeRobot
        return None
    group = next(iter(shard.blocks(0, ["image.bytes"])))
    blobs = group.arrow("image.bytes")[:_TILES].to_pylist()
    return _drawn(_or_none(decode_image, blob) for blob in blobs)


def _drawn(images: Iterable[Pixels | None]) -> bytes | None:
    whole = [image for image in images if image is not None]
    return png_bytes(contact_sheet(whole, tile_width=_TILE_WIDTH)) if whole else None


def _first_shard(facts: FolderFacts) -> Shard | None:
    return next((shard for split in facts.splits for shard in split.shards if len(shard)), None)


def _first_rounds(facts: FolderFacts, kind: Kind) -> Iterator[TouchSeqRound | TouchSingleRound]:
    """Yield the first rounds, decoding the blocks they lie in and keeping none in the cache."""
    home = TouchSingleRound if kind == "single" else TouchSeqRound
    shard = _first_shard(facts)
    for group in islice(shard.blocks(0) if shard is not None else (), _ROUNDS_SEEN):
        # One of each block, so that a damaged block does not use up all tries.
        yield home(Row(group, 0))


def _or_none(ask: Callable[..., T], *parts: Any) -> T | None:
    """Return what can be read; None where the data do not have it, or are damaged there."""
    try:
        return ask(*parts)
    except (ToolkitError, KeyError, ValueError):
        return None


_CELL = "m, cell frame"

COLUMNS: dict[str, Column] = {
    "id": ("", "name of the round, unique over all splits"),
    "label": ("", "class of the touched object"),
    "object_id": ("", "`id` of its mesh in MNIST 3D"),
    "pos_in_cell": (f"T x 2, {_CELL}", "intended positions"),
    "plate_z_m": (_CELL, "height of the gel on the plate, from all touches of the round as it was recorded"),
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
    "plate_z_m": (_CELL, "height of the gel on the plate"),
    "sensor_image": ("T images", "what the sensor sees"),
    "info.touched_object_pose.position": (_CELL, "position of the object while it is touched"),
    "info.touched_object_pose.quaternion": ("x, y, z, w", "its orientation then"),
}

_OBJECT_OF_OTHERS: Column = ("", "number of the touched object, as the source gave it")

_FAMILIES: dict[str, Column] = {"info.": ("", "metadata of the round, as recorded")}

INDEX_COLUMNS: dict[str, Column] = {
    "id": ("", "round and touch"),
    "file": ("", "the picture, from the folder of the data set"),
    "sha256": ("hexadecimal", "checksum of the file"),
    "round_id": ("", "name of the round"),
    "touch": ("", "number of the touch in its round, from 0"),
    "frame": ("", "number of the frame in its clip, 0 for single images"),
    "label": ("", "class of the touched object"),
    "label_name": ("", "name of the class"),
    "object_id": ("", "`id` of the mesh of the touched object"),
    **{f"pos_in_cell_{axis}_m": (_CELL, f"intended position, {axis}") for axis in "xy"},
    **{f"gel_{axis}_m": (_CELL, f"position of the gel, {axis}") for axis in "xyz"},
    **{f"gel_q{axis}": ("", f"orientation of the gel, quaternion's {axis}") for axis in "xyzw"},
}

_EXPORT_COLUMNS: dict[str, Column] = {
    **INDEX_COLUMNS,
    "id": ("", "round and touch; of a LeRobotDataset, the number of the episode"),
    "image": ("JPEG", "what the sensor saw at contact, as it was stored"),
    "file": ("", "file of the foreign format, from the folder of the data set"),
    "meta_file": ("", "what the foreign format says of the episodes in it"),
    "meta_sha256": ("hexadecimal", "checksum of that file"),
    "frames": ("", "number of its frames"),
    "first_frame": ("", "number of its first frame in the whole data set"),
}

_FRAMES = """\
```
   cell frame, seen from above                image of the sensor

          y, away from the robot                0 ---------> column, along +x of the gel
          ^                                     |
   +------|------+                              |   $window
   |      |      |                              |
   |      o------|--> x, right of the robot     v
   |             |                              row, along -y of the gel
   +-------------+
     z points up, out of the page
```

Cell frame: origin at the centre of the 120 x 120 mm cell; metres; right-handed. Poses are those of the gel
in this frame; quaternions are x, y, z, w."""

_DRIFT = " The zero of z drifts by up to 3 mm between rounds."
_PLATES = {
    "known": " The plate is z = 0, and the gel that stops on it is at z = 2.125 mm.",
    "stored": " `plate_z_m` is the height of the gel on the plate in each round.",
    "estimated": " Take the deepest touch of a round as the plate.",
}

_FRAMES_OF_OTHERS = """\
Positions and poses, where there are columns of them, are those of the source: metres, in a frame that its
maker knows; quaternions are x, y, z, w. Rows and columns of images lie as they were stored."""

_COMMON = (
    "The pose of the gel is that of the arm; an object may have moved a little while it was touched.",
    "Force is estimated from the arm's joints: 5 N are not the same at every place of the cell.",
    "The gel pad was replaced halfway through the recordings; `info.gel_id`, where it is there, tells which.",
)

_LIMITS: dict[str, tuple[str, ...]] = {
    "seq": (*_COMMON, "Frames are JPEG with coarser colour than brightness; decoders differ by some levels."),
    "single": (*_COMMON, "Images are JPEG; what compression lost is lost."),
    "frames": _COMMON,
    "export": _COMMON,
    "imported": (
        "Nothing is known here of the sensor, of how touches were made, or who may use the images.",
        "Labels and poses are those of the source; nobody compared them with the images.",
    ),
    "synthetic": (
        "Rendered images lack the texture of prints, the wear of gels and the noise of a camera, unless "
        "their source was made with them.",
        "Touch i was rendered against the object pose of touch i - 1 in the published sets.",
    ),
}

_PRINTABILITY = {
    "real": """\
`object_id` is the `id` of the touched object's mesh in its own data set: for the real touches MNIST 3D, whose
splits `printed_train` and `printed_test` were printed, and whose report tells height, walls and volume.""",
    "imported": """\
Nothing is known here of the touched objects.""",
    "synthetic": """\
Nothing was printed: the objects are meshes. `object_id` is the `id` of the mesh in its data set.""",
}


_CardKind = Literal["seq", "single", "synthetic", "frames", "export"]
_PLAIN: dict[_CardKind, dict[str, Column]] = {"frames": INDEX_COLUMNS, "export": _EXPORT_COLUMNS}
"""Columns of folders whose pictures are files, or rows of other formats: no rounds that can be loaded."""

SYNTHETIC = "synthetic"
"""What the option ``touches`` of plain pictures says of touches that were rendered."""
IMPORTED = "imported"
"""What the option ``touches`` of any conversion says where it was of images of others."""

_TITLES: dict[_CardKind, str] = {
    "seq": "Real touches: clips",
    "single": "Real touches: single images",
    "synthetic": "Synthetic touches: single images",
    "frames": "Touches as plain pictures",
    "export": "Touches",
}
_CAPTIONS: dict[_CardKind, str] = {"seq": "Some touches, each at the end of contact"}
_ORIGINS = {"synthetic": "Synthetic", "imported": "Imported"}
_LICENCE = (
    "cc-by-2.0",
    "CC BY 2.0, as the published touches: name their authors, and say what was changed.",
)
_LICENCE_OF_TOUCHES = (
    _LICENCE[0],
    "That of the touches: CC BY 2.0 for the published real ones; name their authors.",
)
_LICENCES = {
    "frames": _LICENCE_OF_TOUCHES,
    "export": _LICENCE_OF_TOUCHES,
    "imported": (
        "other",
        "The terms of the images that were imported: ask whoever made them before passing them on.",
    ),
    "synthetic": (
        "other",
        "The terms of the set that the touches come from; of a published one, see its page on the Hub.",
    ),
}

_CITED = {"real": ("tactile_mnist", "hwd_plus"), "synthetic": ("tactile_mnist",)}
_CITATIONS = {
    "real": (
        "The touches and the digits: Schneider et al. 2025. The digits were made from the handwriting of "
        "HWD+ (Beaulac and Rosenthal 2022)."
    ),
    "imported": "Whoever made the images wants to be named, as they ask for it.",
    "synthetic": "The touches: Schneider et al. 2025.",
}


def write_card(
    folder: DataFolder,
    manifest: Manifest | None = None,
    kind: Literal["seq", "single", "frames", "export"] | None = None,
) -> None:
    """Write ``README.md`` of a folder of touches and the picture that it shows.

    A copy of a published set has no manifest, and its card says so. ``kind`` is what the folder holds, taken
    from manifest and columns where None. InputError: it holds no touches. IntegrityError: a file is missing
    or damaged.
    """
    facts = folder_facts(folder, manifest)
    card = _card_kind(facts, manifest, folder.address(), kind)
    stored: Literal["seq", "single"] = "seq" if card == "seq" else "single"
    options = {} if manifest is None else manifest.spec.get("options", {})
    # Of plain pictures the manifest alone knows whether the touches were rendered.
    plain = card in _PLAIN
    rendered = card == "synthetic" or (plain and options.get("touches") == SYNTHETIC)
    origin = "synthetic" if rendered else "imported" if is_imported(manifest) else "real"
    licence, licence_text = _LICENCES.get(card if origin == "real" else origin, _LICENCE)
    figures = [] if plain else [_split_figures(split, stored) for split in facts.splits]
    size = None if plain else _picture_size(facts, stored)
    columns = _PLAIN[card] if plain else SYNTHETIC_COLUMNS if rendered else COLUMNS
    if origin == "imported":
        columns = {**columns, "object_id": _OBJECT_OF_OTHERS, "sensor_image": ("T images", "as imported")}
    text = EXPORTS.get(str(options.get("layout")), EXPORTS["flat"]) if card == "export" else None
    title = _title(card, origin, text)
    counts = [figure.touches for figure in figures if figure.touches is not None]
    known = len(counts) == len(figures)
    rule = ContactHeight.of(column_types(facts.schema))
    # Rendered touches may show less of the gel; their source knows how much.
    is_known = not (rendered and (plain or rule.plate == "known"))
    window = "18.88 x 14.16 mm of gel" if is_known else "the window of its source"
    height = ("" if rendered else _DRIFT) + ("" if plain else _PLATES[rule.plate])
    limits = [*_LIMITS[card if origin == "real" else origin], *_missed(figures, rule, plain=plain)]
    values = {
        **({} if text is None else text.words(facts.splits[0].split)),
        "title": title,
        "rounds": f"{facts.rows:,}",
        "touches": f"{sum(counts):,}" if known else "an unknown number of",
        "size_text": f", {size[0]} x {size[1]} pixels" if size else "",
        "made": _made(manifest),
        "split_table": _split_table(facts, figures, manifest),
        "contact_rule": str(rule),
        "field_table": field_table(facts, columns, _FAMILIES),
        "frames": _FRAMES_OF_OTHERS if origin == "imported" else _FRAMES.replace("$window", window) + height,
        "limits": "\n".join(f"- {line}" for line in limits),
        "printability": _PRINTABILITY[origin],
        "licence_text": licence_text,
        "citation_text": _CITATIONS[origin],
        "bibtex": bibtex(*_CITED[origin]) if origin in _CITED else "",
    }
    real_tags = ["mnist", "digits", "video"] if card == "seq" else ["mnist", "digits"]
    write_card_files(
        folder,
        facts,
        manifest,
        KIND.card_template.format("imported" if origin == "imported" and card == stored else card),
        values,
        ("touches.png", _sheet(facts, folder, card, stored), _CAPTIONS.get(card, "Some touches")),
        license=licence,
        pretty_name=title,
        task_categories=["robotics", "image-classification"],
        task_ids=["multi-class-image-classification"],
        tags=["tactile", "touch"]
        if origin == "imported"
        else [
            "tactile",
            "active-perception",
            "gelsight",
            "touch",
            *(["synthetic"] if rendered else real_tags),
        ],
    )


def _missed(figures: list[_SplitFigures], rule: ContactHeight, *, plain: bool) -> list[str]:
    """Write how many touches met no object, where the data have it; nothing is known of plain pictures."""
    if plain:
        return missed_text(None, 0)
    found = [(each.touches, each.contact_share) for each in figures if each.touches]
    if any(share is None for _, share in found):
        return []
    touches = sum(count or 0 for count, _ in found)
    in_contact = round(sum((count or 0) * (share or 0.0) for count, share in found))
    return missed_text(touches - in_contact, touches, is_estimated=rule.plate == "estimated")


def _title(card: _CardKind, origin: str, text: ExportText | None) -> str:
    if text is not None:
        return text.title if origin == "real" else f"{_ORIGINS[origin]}: {text.title}"
    title = _TITLES[card].replace("Real", "Imported") if origin == "imported" else _TITLES[card]
    if origin == "real" or card != "frames":
        return title
    return f"{_ORIGINS[origin]} {title[0].lower()}{title[1:]}"


def _card_kind(
    facts: FolderFacts, manifest: Manifest | None, where: str, kind: str | None = None
) -> _CardKind:
    """Tell which card a folder gets; InputError where it holds no touches."""
    operation = None if manifest is None else manifest.spec.get("operation")
    for plain in _PLAIN:
        if kind == plain or operation == plain:
            return plain
    stored = kind_of(facts.schema, where)
    return "synthetic" if stored == "single" and is_synthetic(facts.schema) else stored


def is_synthetic(schema: Any) -> bool:
    """Tell rendered touches from recorded ones: they have a pose of the object for each touch."""
    # Recorded rounds have at most one pose of the object; rendered ones move it after each touch.
    pose = column_type(schema, "info.object_pose.position")
    return pose is not None and list_depth(pose)[0] == 2


def is_imported(manifest: Manifest | None) -> bool:
    """Tell whether a folder holds images of others, be they imported or what was made of such."""
    if manifest is None:
        return False
    options = manifest.spec.get("options")
    touches = options.get("touches") if isinstance(options, dict) else None
    return manifest.spec.get("operation") == "import" or touches == IMPORTED


def _made(manifest: Manifest | None) -> str:
    if manifest is None:
        return (
            "Not made by this toolkit: the folder has no `manifest.json`, and its files are described as "
            "they are. The schema is that of the data sets that the authors of the paper published."
        )
    source = manifest.spec["source"]
    files = ", ".join(f"{split}: {len(names)}" for split, names in source.items())
    rows = ", ".join(f"{split}: {sum(file['rows'] for file in names):,}" for split, names in source.items())
    found = f"files {files}; rounds {rows}; `manifest.json` names and fingerprints each file"
    if manifest.spec["operation"] == "import":
        found = f"images {rows}; `manifest.json` has the checksum of their list"
    lines = [
        made_by(manifest),
        ("command", f"`realtouch {manifest.spec['operation']}`"),
        ("source", found),
        ("rounds left out", skipped_text(manifest)),
    ]
    return markdown_table(("", ""), lines) + "\n\nOptions:\n\n" + json_block(manifest.spec["options"])


def _split_table(facts: FolderFacts, figures: list[_SplitFigures], manifest: Manifest | None) -> str:
    left_out = {} if manifest is None else manifest.split_table()
    sizes = [
        (len(split.paths), megabytes(split.file_bytes), megabytes(split.unpacked_bytes))
        for split in facts.splits
    ]
    if not figures:
        rows = [
            (markdown_text(s.split), f"{s.rows:,}", *size)
            for s, size in zip(facts.splits, sizes, strict=True)
        ]
        options = {} if manifest is None else manifest.spec.get("options", {})
        counted = "rounds" if options.get("layout") == "lerobot" else "pictures"
        return markdown_table(("split", counted, "shards", "Parquet", "unpacked"), rows)
    header = ("split", "rounds", "touches", "per round", "objects", "contact", "left out")

    def number(count: int | None) -> str:
        return "-" if count is None else f"{count:,}"

    cells = [
        (
            markdown_text(s.split),
            f"{s.rows:,}",
            number(figure.touches),
            "-" if figure.per_round is None else between(*figure.per_round),
            number(figure.objects),
            "-" if figure.contact_share is None else f"{100 * figure.contact_share:.1f} %",
            str(left_out[s.split]["skipped"]) if s.split in left_out else "-",
            *size,
        )
        for s, figure, size in zip(facts.splits, figures, sizes, strict=True)
    ]
    return markdown_table((*header, "shards", "Parquet", "unpacked"), cells)
