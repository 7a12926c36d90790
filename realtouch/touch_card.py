"""The data card of a data set of touches, converted or published; its words are in ``data_cards``."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import islice
from operator import attrgetter
from typing import Any, TypeVar

import numpy as np
import pyarrow as pa

from realtouch.kind import KIND
from realtouch.touches import datasets, media, rounds, schema, stored_round
from realtouch.touches.rounds import Touch
from tactile_toolkit import cards, errors, read, store, touch, wording
from tactile_toolkit.pictures import Tile, fitted, sheet
from tactile_toolkit.value_types import Int64, JsonDict, UInt8

WORDS = "touch_words.toml"
"""File of ``data_cards`` with the words of all cards of touches."""

T = TypeVar("T")
_TILES = 16
_TILE_WIDTH = 96
_GAP_PX = 4
# Each round requires unpacking a block; a card does not try all blocks of a damaged set.
_ROUNDS_SEEN = 4
_TASKS = {
    "task_categories": ["robotics", "image-classification"],
    "task_ids": ["multi-class-image-classification"],
}
_LIST_SUFFIX = re.compile(r"(?:\.list\.(?:element|item))+\Z")
_MAY_HAVE_MISSED = (
    "Some touches may have met no object; `tactile select --contact` takes them out of the source."
)
_WINDOW = "18.88 x 14.16 mm of gel"


@dataclass(frozen=True, slots=True)
class _Content:
    """Content of a card that depends on the rows: texts, columns and counts."""

    words: JsonDict
    columns: dict[str, tuple[str, str]]
    nouns: str
    pictures: Iterable[UInt8 | None]
    values: dict[str, str]
    limits: list[str]
    figures: dict[str, list[str]]


def write_card(folder: store.DataFolder, manifest: store.Manifest | None = None) -> None:
    """Write ``README.md`` of a folder of touches and the picture that it shows.

    A copy of a published set has no manifest, and its card says so. InputError: it holds no touches.
    IntegrityError: a file is missing or damaged.
    """
    words = cards.Card.words(WORDS)
    facts = cards.FolderSummary.of(folder, manifest)
    types = read.column_types(facts.schema)
    origin = schema.origin_of(facts.schema, manifest)
    of_origin = words["origins"][origin]
    family = touch.sensor_family(schema.sensor_of(facts.schema, manifest))
    contact_sources = schema.ContactSource.of_files(facts.table.schemas)  # merged sets may have several
    licence_text = of_origin["licence_text"]
    heights = [of_origin.get("drift")]
    # Plain pictures and rows in foreign formats are not rounds that could be loaded.
    if manifest is not None and manifest.spec.get("operation") == "export":
        layout = manifest.spec["options"]["layout"]
        template = "frames" if layout in touch.IMAGE_SUFFIX else "export"
        licence_text = of_origin.get("licence_of_others", licence_text)
        content = _plain_content(folder, facts, layout, words)
        for name in ("content_text", "loading"):
            content.values[name] = content.values[name].replace("$sensor_family", family)
    else:
        kind = schema.media_kind(facts.schema, folder.address())
        template = kind if origin == "real" else origin
        content = _stored_content(facts, kind, types, contact_sources, manifest, words)
        content.columns["object_id"] = ("", of_origin["object_id"])
        content.columns.update(_extra_words(facts))
        plates = dict.fromkeys(source.heights.plate for source in contact_sources if source.heights)
        heights += [words["plates"][plate] for plate in plates]
    tags = [tag.replace("$sensor_family", family) for tag in of_origin["tags"]]
    caption = "Some touches"
    if template == "seq":
        tags.append("video")
        caption = "Some touches, each at the end of contact"
    cards.Card(
        template=KIND.card_template.format(template),
        title=f"{of_origin['title']} {content.words['title']}",
        columns=content.columns,
        picture=("touches.png", caption),
        drawn=lambda _facts: _sheet(content.pictures),
        licence=of_origin["licence"],
        tags=tags,
        nouns=content.nouns,
        tasks=_TASKS,
        figures=content.figures,
        made=[] if manifest is None else _made(manifest),
        limits=_limits(origin, of_origin["limits"], content),
        spec=None if manifest is None else manifest.spec["options"],
        values={
            **content.values,
            **({"made": words["made"]["unknown"]} if manifest is None else {}),
            "rounds": f"{facts.rows:,}",
            "contact_rule": "; or ".join(map(str, contact_sources)),
            **_values_of_origin(of_origin, words["frames"]["cell"], heights),
            "licence_text": licence_text,
        },
        cited=of_origin["cited"],
    ).write(folder, manifest, KIND, facts)


def _limits(origin: str, of_origin: Sequence[str], content: _Content) -> list[str]:
    """Return the known limits of the data; those of a kind of rounds apply to real touches only."""
    if origin == "real":
        return [*of_origin, *content.words.get("limits", ()), *content.limits]
    return [*of_origin, *content.limits]


def _values_of_origin(of_origin: JsonDict, cell: str, heights: list[str | None]) -> dict[str, str]:
    """Return the texts of a card that depend on where the touches are from."""
    cell = cell.replace("$window", of_origin.get("window", _WINDOW))
    return {
        "frames": of_origin.get("frames", " ".join(filter(None, [cell, *heights]))),
        "printability": of_origin["printability"],
        "citation_text": of_origin["citation_text"],
    }


def _plain_content(
    folder: store.DataFolder,
    facts: cards.FolderSummary,
    layout: str,
    words: JsonDict,
) -> _Content:
    """Return the content of a card about picture files, or about rows in a foreign format."""
    of_layout = words["layouts"][layout]
    placeholders = ("layout_text", "content_text", "size_note", "loading")
    texts = {name: of_layout.get(name, "") for name in placeholders}
    texts["loading"] = texts["loading"].replace("$first_split", facts.splits[0].split)
    nouns = "rounds" if layout == "lerobot" else "pictures"
    pictures = _plain_pictures(folder, facts)
    return _Content(of_layout, words["columns"]["plain"], nouns, pictures, texts, [_MAY_HAVE_MISSED], {})


def _plain_pictures(folder: store.DataFolder, facts: cards.FolderSummary) -> Iterator[UInt8 | None]:
    """Decode the first pictures of an index of files or of a column of images; tars give no pictures."""
    names = read.column_names(facts.schema)
    if "image.bytes" in names:
        for row in islice(facts.first_rows(["image.bytes"]), _TILES):
            yield _or_none(touch.decode_image, row.group.arrow("image.bytes")[row.index].as_py())
    elif {"file", "frame", "label"} <= {*names}:
        for row in islice(facts.first_rows(["file"]), _TILES):
            if row.value("file").endswith((".jpg", ".png")):
                yield _or_none(lambda name: touch.decode_image(folder.read_bytes(name)), row.value("file"))


def _stored_content(
    facts: cards.FolderSummary,
    kind: schema.Kind,
    types: Mapping[str, pa.DataType],
    contact_sources: Sequence[schema.ContactSource],
    manifest: store.Manifest | None,
    words: JsonDict,
) -> _Content:
    """Return the content of a card about rounds; reads small columns and a few rounds."""
    by_split = [datasets.dataset_of(split.shards) if split.rows else None for split in facts.splits]

    def of_each(count: Callable[[datasets.AnyDataset], Any], empty: Any = None) -> list[Any]:
        return [empty if dataset is None else _or_none(count, dataset) for dataset in by_split]

    counts = of_each(attrgetter("touch_counts"), np.zeros(0, np.int64))
    touches: list[Any] = [None if of_split is None else int(of_split.sum()) for of_split in counts]
    objects: list[int | None] = [0 if dataset is None else None for dataset in by_split]
    shares: list[float | None] = [None] * len(by_split)
    if "object_id" in types:
        objects = of_each(lambda dataset: len(np.unique(dataset.column("object_id"))), 0)
    contact_source = schema.ContactSource.of(types)
    if all(source.is_stored for source in contact_sources):  # else all pictures would be decoded
        shares = of_each(lambda dataset: float(dataset.touches().in_contact().mean()))
    size, pictures = _seen(facts, kind)
    left_out = {} if manifest is None else manifest.split_table()
    return _Content(
        words["kinds"][kind],
        words["columns"]["rounds"],
        "rounds",
        pictures,
        {
            "touches": "an unknown number of" if None in touches else f"{sum(touches):,}",
            "size_text": f", {size[0]} x {size[1]} pixels" if size else "",
        },
        _missed(touches, shares, contact_source.heights or touch.HeightRule(0.0, "known")),
        {
            "touches": [_text("{:,}", count) for count in touches],
            "per round": [
                "-" if of_split is None or not len(of_split) else _range_text(of_split) for of_split in counts
            ],
            "objects": [_text("{:,}", count) for count in objects],
            "contact": [_text("{:.1%}", share).replace("%", " %") for share in shares],
            "left out": [_text("{}", left_out.get(s.split, {}).get("skipped")) for s in facts.splits],
        },
    )


def _extra_words(facts: cards.FolderSummary) -> dict[str, tuple[str, str]]:
    """Describe the further columns of rounds, with the range of their numbers as the footers state it."""
    ends: dict[str, list[Any]] = {}
    for shard in facts.table.files:
        for chunk in shard.column_chunks():
            name = _LIST_SUFFIX.sub("", chunk.path_in_schema)
            statistics = chunk.statistics
            if statistics is not None and statistics.has_min_max:
                ends.setdefault(name, []).extend([statistics.min, statistics.max])
            elif statistics is None or statistics.null_count < chunk.num_values:
                ends.setdefault(name, []).append("")  # a range of the rest would be too small
    words = {}
    names = schema.extra_columns(facts.schema.names)
    codes = [wording.markdown_code(name) for name in names]
    for code, stored in zip(codes, names.values(), strict=True):
        shape = "T x N; cut to N_i" if stored.startswith(schema.EXTRA_PREFIX["frame"]) else "T"
        numbers = ends.get(stored, [""])
        is_known = all(isinstance(end, (int, float)) for end in numbers)
        # Parquet may state 0 as -0, so 0 is added.
        between = f", {min(numbers) + 0:g} to {max(numbers) + 0:g}" if is_known else ""
        words[stored] = (shape, f"{code} of the source{between}")
    return words


def _range_text(counts: Int64) -> str:
    return " to ".join(f"{count:,}" for count in dict.fromkeys((min(counts), max(counts))))


def _text(form: str, figure: float | None) -> str:
    return "-" if figure is None else form.format(figure)


def _seen(facts: cards.FolderSummary, kind: schema.Kind) -> tuple[tuple[int, int] | None, list[UInt8 | None]]:
    """Return the size of pictures, and those of the first round that has a readable one.

    Clips show the end of contact.
    """
    size = None
    pictures: list[UInt8 | None] = []
    for record in _first_rounds(facts, kind):
        count = _or_none(attrgetter("touch_count"), record) or 0
        tiles = media.evenly_spaced(count, _TILES)
        pictures = [_or_none(attrgetter("image"), Touch(record, number)) for number in tiles]
        intact = next((picture for picture in pictures if picture is not None), None)
        if intact is not None:
            return size or intact.shape[1::-1], pictures
        size = size or _or_none(record.picture_size, 0)
    return size, []


def _sheet(pictures: Iterable[UInt8 | None]) -> bytes | None:
    intact = [image for image in pictures if image is not None]
    return touch.encode_image(contact_sheet(intact, tile_width=_TILE_WIDTH), "png") if intact else None


def contact_sheet(images: Sequence[UInt8], columns: int = 8, tile_width: int = 120) -> UInt8:
    """Arrange RGB images, (H, W, 3), in rows of ``columns``, each ``tile_width`` pixels wide.

    All get the proportions of the first.
    """
    height = fitted(images[0], tile_width).shape[0]
    tiles = [Tile(touch.resized(image, tile_width, height)) for image in images]
    return sheet(tiles, min(columns, len(images)), gap_px=_GAP_PX, margin_px=_GAP_PX)


def _first_rounds(
    facts: cards.FolderSummary, kind: schema.Kind
) -> Iterator[rounds.TouchSeqRound | rounds.TouchSingleRound]:
    """Yield the first round of each of the first blocks; the blocks are not kept in the cache."""
    record = rounds.TouchSingleRound if kind == "single" else rounds.TouchSeqRound
    shard = next(filter(len, facts.table.files), None)
    if shard is None:
        return
    for group in islice(shard.blocks(0), _ROUNDS_SEEN):
        # One round of each block, so that a damaged block does not use up all tries.
        yield record(stored_round.StoredRound(group, 0))


def _or_none(ask: Callable[..., T], *parts: object) -> T | None:
    """Return the result of reading something; None if it is missing or damaged."""
    try:
        return ask(*parts)
    except (errors.ToolkitError, KeyError, ValueError):
        return None


def _missed(touches: list[int | None], shares: list[float | None], rule: touch.HeightRule) -> list[str]:
    """State how many touches met no object, if this is known.

    ``touches`` and ``shares`` have one entry for each split: its touches, and the share that met an object.
    """
    known = [(count, share) for count, share in zip(touches, shares, strict=True) if count]
    if any(share is None for _, share in known):
        return []
    total = sum(count for count, _ in known)
    in_contact = sum(count * (share or 0) for count, share in known)
    return rule.missed_lines(total - round(in_contact), total)


def _made(manifest: store.Manifest) -> list[tuple[str, str]]:
    operation, source = manifest.spec["operation"], manifest.spec["source"]
    files = ", ".join(f"{split}: {len(names)}" for split, names in source.items())
    rows = ", ".join(f"{split}: {sum(file['rows'] for file in names):,}" for split, names in source.items())
    text = f"files {files}; rounds {rows}; `manifest.json` names and fingerprints each file"
    if operation == "import":
        text = f"images {rows}; `manifest.json` has the checksum of their list"
    return [("command", f"`{KIND.command_of(manifest)}`"), ("source", text)]
