"""The data card of a training set of learned rendering."""

from __future__ import annotations

from typing import Any

import numpy as np

from tactile_sim.pairs.making import SPLITS
from tactile_sim.pairs.rows import decode_depth
from tactile_sim.sheets import tile
from tactile_toolkit.cards.card import (
    Column,
    bibtex,
    field_table,
    json_block,
    made_by,
    markdown_table,
    megabytes,
    skipped_text,
    write_card_files,
)
from tactile_toolkit.cards.facts import FolderFacts, folder_facts
from tactile_toolkit.pictures.writing import png_bytes
from tactile_toolkit.store.folder import DataFolder
from tactile_toolkit.store.manifest import Manifest
from tactile_toolkit.touch.contact import height_text
from tactile_toolkit.touch.jpeg import decode_image

__all__ = ["COLUMNS", "write_card"]

_SHOWN = 8
COLUMNS: dict[str, Column] = {
    "id": ("", "object and number, or round and touch"),
    "label": ("", "class of the touched object"),
    "object_id": ("", "`id` of its mesh"),
    "contact": ("", "whether the gel met the object"),
    "sensor_image": ("H x W", "depth: grey, 16 bits, 0 deepest in the gel, 65535 no contact; real: colours"),
}


def write_card(folder: DataFolder, manifest: Manifest) -> None:
    """Write ``README.md`` of a training set and the picture that it shows."""
    facts = folder_facts(folder, manifest)
    spec = manifest.spec["options"]
    width, height = spec["size_px"]
    counts = {split: [record.statistics or {} for record in manifest.shards_of(split)] for split in SPLITS}
    rows = []
    for split in facts.splits:
        met = sum(part.get("on_object", 0) for part in counts[split.split])
        sizes = len(split.paths), megabytes(split.file_bytes), megabytes(split.unpacked_bytes)
        rows.append((split.split, f"{split.rows:,}", f"{met:,}", *sizes))
    made = [
        made_by(manifest),
        ("without contact, asked for", f"{100 * spec['without_contact']:.4g} % of each split"),
        ("contact", height_text(spec["min_height_m"])),
        ("objects left out", skipped_text(manifest)),
    ]
    values = {
        "size_text": f"{width} x {height} pixels",
        "made": markdown_table(("", ""), made) + "\n\n" + json_block(manifest.spec),
        "split_table": markdown_table(
            ("split", "rows", "with contact", "shards", "Parquet", "unpacked"), rows
        ),
        "field_table": field_table(facts, COLUMNS),
        "bibtex": bibtex("tactile_mnist"),
    }
    write_card_files(
        folder,
        facts,
        manifest,
        "touch_pairs.md",
        values,
        ("pairs.png", _sheet(facts), "Depth images above, touches below; they do not belong together"),
        license="other",
        pretty_name="Depth and touch, not paired",
        task_categories=["image-to-image", "robotics"],
        tags=["tactile", "gelsight", "touch", "cyclegan"],
    )


def _sheet(facts: FolderFacts) -> bytes | None:
    """Draw the first rows of both splits, one above the other, as PNG."""
    rows = []
    for split in facts.splits:
        block = next(split.shards[0].blocks(0, ["sensor_image"]))
        decode: Any = decode_depth if split.split == "depth" else decode_image
        images = [decode(each["bytes"]) for each in block.table.column(0)[:_SHOWN].to_pylist()]
        rows.append(np.concatenate([tile(image) for image in images], axis=1))
    shown: Any = [row[:, : min(row.shape[1] for row in rows)] for row in rows]
    return png_bytes(np.concatenate(shown)) if rows else None
