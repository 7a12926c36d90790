"""The data card of a data set of touches, converted or published; its words are in ``data_cards``."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from itertools import islice
from operator import attrgetter
from typing import Any, Literal, NamedTuple, TypeVar

import numpy as np

from realtouch.dataset import dataset_of
from realtouch.images import contact_sheet, evenly_spaced
from realtouch.kind import KIND
from realtouch.rounds import TouchSeqRound, TouchSingleRound
from realtouch.touch import Touch
from tactile_toolkit.cards.card import Card, Column, between, bibtex, card_words
from tactile_toolkit.cards.facts import FolderFacts, SplitFacts, folder_facts
from tactile_toolkit.errors import ToolkitError
from tactile_toolkit.pictures.sheets import png_bytes
from tactile_toolkit.read.columns import column_types
from tactile_toolkit.read.dataset import Row
from tactile_toolkit.read.parquet import Shard
from tactile_toolkit.store.folder import DataFolder
from tactile_toolkit.store.manifest import Manifest
from tactile_toolkit.touch.contact import ContactHeight, missed_text
from tactile_toolkit.touch.jpeg import Pixels, decode_image
from tactile_toolkit.touch.schema import Kind, is_rendered, kind_of

Origin = Literal["real", "synthetic", "imported"]
"""Where touches are from; manifests of conversions state it as the option ``touches``."""

T = TypeVar("T")
_TILES = 16
_TILE_WIDTH = 96
# Each is a block to unpack: of a damaged set a card should not try them all.
_ROUNDS_SEEN = 4

_COMMANDS = {"to-single": "clips-to-images"}  # manifests of all versions have the former name
_CELL = "m, cell frame"
_WINDOW = "18.88 x 14.16 mm of gel"

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
    "info.touched_object_pose.position": (_CELL, "position of the object while it is touched"),
    "info.touched_object_pose.quaternion": ("x, y, z, w", "its orientation then"),
    "info.": ("", "metadata of the round, as recorded"),
}

_PLAIN_COLUMNS: dict[str, Column] = {
    "id": ("", "round and touch; of a LeRobotDataset, the number of the episode"),
    "image": ("JPEG", "what the sensor saw at contact, as it was stored"),
    "file": ("", "file of a picture or of the foreign format, from the folder of the data set"),
    "sha256": ("hexadecimal", "checksum of the file"),
    "meta_file": ("", "what the foreign format states about the episodes in it"),
    "meta_sha256": ("hexadecimal", "checksum of that file"),
    "round_id": ("", "name of the round"),
    "touch": ("", "number of the touch in its round, from 0"),
    "frame": ("", "number of the frame in its clip, 0 for single images"),
    "frames": ("", "number of its frames"),
    "first_frame": ("", "number of its first frame in the whole data set"),
    "label": ("", "class of the touched object"),
    "label_name": ("", "name of the class"),
    "object_id": ("", "`id` of the mesh of the touched object"),
    **{f"pos_in_cell_{axis}_m": (_CELL, f"intended position, {axis}") for axis in "xy"},
    **{f"gel_{axis}_m": (_CELL, f"position of the gel, {axis}") for axis in "xyz"},
    **{f"gel_q{axis}": ("", f"orientation of the gel, quaternion's {axis}") for axis in "xyzw"},
}


def origin_of(schema: Any, manifest: Manifest | None) -> Origin:
    """Return where touches are from: rendered ones by their columns, others by the manifest."""
    options = None if manifest is None else manifest.spec.get("options")
    stated = options.get("touches") if isinstance(options, dict) else None
    if stated == "imported" or (manifest is not None and manifest.spec.get("operation") == "import"):
        return "imported"
    return "synthetic" if stated == "synthetic" or is_rendered(schema) else "real"


@dataclass(frozen=True, slots=True)
class _Content:
    """What a card says of the rows at hand: the words of their kind, columns, and what was counted."""

    words: dict[str, Any]
    columns: dict[str, Column]
    nouns: str
    pictures: Iterable[Pixels | None]
    values: dict[str, str]
    limits: list[str]
    figures: dict[str, list[str]]


def write_card(folder: DataFolder, manifest: Manifest | None = None) -> None:
    """Write ``README.md`` of a folder of touches and the picture that it shows.

    A copy of a published set has no manifest, and its card says so. InputError: it holds no touches.
    IntegrityError: a file is missing or damaged.
    """
    words = card_words("touch_words.toml")
    facts = folder_facts(folder, manifest)
    operation = None if manifest is None else manifest.spec.get("operation")
    origin = origin_of(facts.schema, manifest)
    of_origin = words["origins"][origin]
    rule = ContactHeight.of(column_types(facts.schema))
    # Of plain pictures, and of rows in foreign formats, there are no rounds that could be loaded.
    is_plain = operation in ("frames", "export")
    if is_plain:
        template, licence_text = str(operation), of_origin.get("licence_of_others", of_origin["licence_text"])
        content = _plain_content(folder, facts, manifest, words)
        heights = [of_origin.get("drift")]
    else:
        kind = kind_of(facts.schema, folder.address())
        template, licence_text = kind if origin == "real" else origin, of_origin["licence_text"]
        content = _stored_content(facts, kind, rule, manifest, words["kinds"][kind])
        content.columns["object_id"] = ("", of_origin["object_id"])
        heights = [of_origin.get("drift"), words["plates"][rule.plate]]
    cell = words["frames"]["cell"].replace("$window", of_origin.get("window", _WINDOW))
    in_cell = " ".join(filter(None, [cell, *heights]))
    is_clips = template == "seq"
    unknown = {} if manifest is not None else {"made": words["made"]["unknown"]}
    Card(
        template=KIND.card_template.format(template),
        title=f"{of_origin['title']} {content.words['title']}",
        columns=content.columns,
        picture=(
            "touches.png",
            lambda _facts: _sheet(content.pictures),
            "Some touches, each at the end of contact" if is_clips else "Some touches",
        ),
        licence=of_origin["licence"],
        tags=[*of_origin["tags"], *(["video"] if is_clips else [])],
        nouns=content.nouns,
        tasks={
            "task_categories": ["robotics", "image-classification"],
            "task_ids": ["multi-class-image-classification"],
        },
        figures=content.figures,
        made=[] if manifest is None else _made(manifest),
        limits=[
            *of_origin["limits"],
            *(content.words.get("limits", ()) if origin == "real" else ()),
            *content.limits,
        ],
        spec=None if manifest is None else manifest.spec["options"],
        values={
            **content.values,
            **unknown,
            "rounds": f"{facts.rows:,}",
            "contact_rule": str(rule),
            "frames": of_origin.get("frames", in_cell),
            "printability": of_origin["printability"],
            "licence_text": licence_text,
            "citation_text": of_origin["citation_text"],
            "bibtex": bibtex(*of_origin["cited"]) if of_origin["cited"] else "",
        },
    ).write(folder, manifest, KIND, facts)


def _plain_content(
    folder: DataFolder, facts: FolderFacts, manifest: Manifest | None, words: dict[str, Any]
) -> _Content:
    """Return what a card says of pictures in files, or of rows in a foreign format."""
    layout = "frames" if manifest is None else manifest.spec["options"].get("layout", "frames")
    of_layout = words["layouts"][layout]
    placeholders = ("layout_text", "content_text", "size_note", "loading")
    texts = {name: of_layout.get(name, "") for name in placeholders}
    texts["loading"] = texts["loading"].replace("$first_split", facts.splits[0].split)
    nouns = "rounds" if layout == "lerobot" else "pictures"
    pictures = _plain_pictures(folder, facts)
    return _Content(of_layout, _PLAIN_COLUMNS, nouns, pictures, texts, missed_text(None, 0), {})


def _plain_pictures(folder: DataFolder, facts: FolderFacts) -> Iterator[Pixels | None]:
    """Decode the first pictures of an index of files or of a column of images; of tars there are none."""
    shard = _first_shard(facts)
    if shard is not None and "image.bytes" in shard.types:
        group = next(iter(shard.blocks(0, ["image.bytes"])))
        yield from (_or_none(decode_image, each) for each in group.arrow("image.bytes")[:_TILES].to_pylist())
    elif shard is not None and "frame" in shard.types and "label" in shard.types:
        names = shard.read(columns=["file"]).column(0).to_pylist()[:_TILES]
        if names[0].endswith((".jpg", ".png")):
            yield from (_or_none(lambda name: decode_image(folder.read_bytes(name)), name) for name in names)


def _stored_content(
    facts: FolderFacts, kind: Kind, rule: ContactHeight, manifest: Manifest | None, words: dict[str, Any]
) -> _Content:
    """Return what a card says of rounds; reads small columns and a few rounds."""
    figures = [_split_figures(split, kind) for split in facts.splits]
    counts = [figure.touches for figure in figures if figure.touches is not None]
    sizes = (_or_none(record._picture_size, 0) for record in _first_rounds(facts, kind))
    size = next(filter(None, sizes), None)
    left_out = {} if manifest is None else manifest.split_table()
    return _Content(
        words,
        dict(COLUMNS),
        "rounds",
        _stored_pictures(facts, kind),
        {
            "touches": f"{sum(counts):,}" if len(counts) == len(figures) else "an unknown number of",
            "size_text": f", {size[0]} x {size[1]} pixels" if size else "",
        },
        _missed(figures, rule),
        {
            "touches": [_text("{:,}", each.touches) for each in figures],
            "per round": ["-" if each.per_round is None else between(*each.per_round) for each in figures],
            "objects": [_text("{:,}", each.objects) for each in figures],
            "contact": [_text("{:.1%}", each.contact_share).replace("%", " %") for each in figures],
            "left out": [_text("{}", left_out.get(s.split, {}).get("skipped")) for s in facts.splits],
        },
    )


def _text(form: str, figure: float | None) -> str:
    return "-" if figure is None else form.format(figure)


def _stored_pictures(facts: FolderFacts, kind: Kind) -> list[Pixels | None]:
    """Decode pictures of the first round of which one can be read; of clips, the end of contact."""
    for record in _first_rounds(facts, kind):
        count = _or_none(attrgetter("touch_count"), record) or 0
        images = [_or_none(attrgetter("image"), Touch(record, each)) for each in evenly_spaced(count, _TILES)]
        if any(image is not None for image in images):
            return images
    return []


def _sheet(pictures: Iterable[Pixels | None]) -> bytes | None:
    intact = [image for image in pictures if image is not None]
    return png_bytes(contact_sheet(intact, tile_width=_TILE_WIDTH)) if intact else None


def _first_shard(facts: FolderFacts) -> Shard | None:
    return next((shard for split in facts.splits for shard in split.shards if len(shard)), None)


def _first_rounds(facts: FolderFacts, kind: Kind) -> Iterator[TouchSeqRound | TouchSingleRound]:
    """Yield the first rounds, decoding the blocks they lie in and keeping none in the cache."""
    record = TouchSingleRound if kind == "single" else TouchSeqRound
    shard = _first_shard(facts)
    for group in islice(shard.blocks(0) if shard is not None else (), _ROUNDS_SEEN):
        # One of each block, so that a damaged block does not use up all tries.
        yield record(Row(group, 0))


def _or_none(ask: Callable[..., T], *parts: Any) -> T | None:
    """Return what can be read; None where the data do not have it, or are damaged there."""
    try:
        return ask(*parts)
    except (ToolkitError, KeyError, ValueError):
        return None


class _SplitFigures(NamedTuple):
    """One split in numbers; None where the data do not say."""

    touches: int | None
    per_round: tuple[int, int] | None  # least and most touches
    objects: int | None
    contact_share: float | None


def _split_figures(split: SplitFacts, kind: Kind) -> _SplitFigures:
    """Count one split; reads small columns, no image or clip."""
    if not split.rows:
        return _SplitFigures(0, None, 0, None)
    dataset = dataset_of(split.shards)
    return _SplitFigures(
        _or_none(lambda: int(dataset.touch_counts.sum())),
        _or_none(lambda: (int(dataset.touch_counts.min()), int(dataset.touch_counts.max()))),
        _or_none(lambda: len(np.unique(dataset.column("object_id")))),
        _or_none(lambda: float(dataset.touches().in_contact().mean())),
    )


def _missed(figures: list[_SplitFigures], rule: ContactHeight) -> list[str]:
    """Write how many touches met no object, where the data have it."""
    found = [(each.touches, each.contact_share) for each in figures if each.touches]
    if any(share is None for _, share in found):
        return []
    touches = sum(count or 0 for count, _ in found)
    in_contact = round(sum((count or 0) * (share or 0.0) for count, share in found))
    return missed_text(touches - in_contact, touches, is_estimated=rule.plate == "estimated")


def _made(manifest: Manifest) -> list[tuple[str, str]]:
    operation, source = manifest.spec["operation"], manifest.spec["source"]
    files = ", ".join(f"{split}: {len(names)}" for split, names in source.items())
    rows = ", ".join(f"{split}: {sum(file['rows'] for file in names):,}" for split, names in source.items())
    found = f"files {files}; rounds {rows}; `manifest.json` names and fingerprints each file"
    if operation == "import":
        found = f"images {rows}; `manifest.json` has the checksum of their list"
    return [("command", f"`{KIND.command} {_COMMANDS.get(operation, operation)}`"), ("source", found)]
