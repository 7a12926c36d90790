"""The data card of a training set of learned rendering."""

from __future__ import annotations

from typing import Any

import numpy as np

from tactile_sim.kind import KIND
from tactile_sim.pairs.rows import PairRow, decode_depth
from tactile_sim.sheets import tile
from tactile_toolkit.cards.card import Card
from tactile_toolkit.cards.facts import FolderFacts, folder_facts
from tactile_toolkit.pictures.writing import png_bytes
from tactile_toolkit.rows import meanings
from tactile_toolkit.store.folder import DataFolder
from tactile_toolkit.store.manifest import Manifest
from tactile_toolkit.touch.contact import height_text
from tactile_toolkit.touch.jpeg import decode_image

_SHOWN = 8


def write_card(folder: DataFolder, manifest: Manifest) -> None:
    """Write ``README.md`` of a training set and the picture that it shows."""
    facts = folder_facts(folder, manifest)
    spec = manifest.spec["options"]
    width, height = spec["size_px"]
    counts = manifest.statistics()
    Card(
        template="touch_pairs.md",
        title="Depth and touch, not paired",
        columns=meanings(PairRow),
        picture=(
            "pairs.png",
            _sheet(facts),
            "Depth images above, touches below; they do not belong together",
        ),
        licence="other",
        tags=["tactile", "gelsight", "touch", "cyclegan"],
        tasks={"task_categories": ["image-to-image", "robotics"]},
        figures={"with contact": [f"{counts[split.split]['on_object']:,}" for split in facts.splits]},
        made=[
            ("without contact, asked for", f"{100 * spec['without_contact']:.4g} % of each split"),
            ("contact", height_text(spec["min_height_m"])),
        ],
        values={"size_text": f"{width} x {height} pixels"},
    ).write(folder, facts, manifest, KIND)


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
