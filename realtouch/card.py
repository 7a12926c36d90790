"""The data card of a converted data set of touches."""

from __future__ import annotations

import json
from typing import Literal

from dataset_store.cards import front_matter, markdown_table, render_card, write_card_text
from dataset_store.manifest import Manifest
from dataset_store.storage import DataFolder

__all__ = ["write_card"]

_TEMPLATES = {"single": "touch_single.md", "seq": "touch_seq.md", "frames": "touch_frames.md"}


def write_card(folder: DataFolder, manifest: Manifest, kind: Literal["seq", "single", "frames"]) -> None:
    """Write ``README.md`` of a converted data set from its manifest.

    Raises
    ------
    StorageError
        When the folder cannot be written.
    """
    head = front_matter(
        manifest,
        license="cc-by-2.0",
        pretty_name=f"Real touches, {manifest.spec['operation']}",
        task_categories=["robotics"],
        tags=["tactile", "gelsight", "touch"],
    )
    table = manifest.split_table()
    rows = [
        (split, e["rows"], e["shards"], f"{e['bytes'] / 1e6:.1f} MB", e["skipped"])
        for split, e in table.items()
    ]
    files = {split: [entry["file"] for entry in listed] for split, listed in manifest.spec["source"].items()}
    values = {
        "rows": f"{sum(entry['rows'] for entry in table.values()):,}",
        "version": manifest.toolkit_version,
        "operation": str(manifest.spec["operation"]),
        "options": json.dumps(manifest.spec["options"], indent=2),
        "split_table": markdown_table(("split", "rows", "shards", "Parquet", "left out"), rows),
        "source_files": ", ".join(f"{split}: {len(names)} files" for split, names in files.items()),
        "first_split": manifest.splits[0] if manifest.splits else "train",
    }
    write_card_text(folder, head + "\n" + render_card(_TEMPLATES[kind], values))
