"""The data card of a data set of synthetic touches."""

from __future__ import annotations

from itertools import islice
from typing import Any

import numpy as np

from tactile_sim.kind import KIND
from tactile_sim.sheets import tile
from tactile_toolkit.cards.card import (
    Column,
    bibtex,
    field_table,
    first_rows,
    json_block,
    made_by,
    markdown_table,
    megabytes,
    skipped_text,
    write_card_files,
)
from tactile_toolkit.cards.facts import FolderFacts, folder_facts
from tactile_toolkit.kind import lazy
from tactile_toolkit.pictures.writing import png_bytes
from tactile_toolkit.store.folder import DataFolder
from tactile_toolkit.store.manifest import Manifest
from tactile_toolkit.touch.contact import missed_text
from tactile_toolkit.touch.jpeg import decode_image

__all__ = ["COLUMNS", "write_card"]

_COLUMNS_SHOWN = 8
_ROUNDS_SHOWN = 4
_CELL = "m, cell frame"

COLUMNS: dict[str, Column] = {
    "id": ("", "`object_id` and number of the round"),
    "label": ("", "class of the touched object"),
    "object_id": ("", "`id` of its mesh in the data set of the objects"),
    "info.object_pose.position": (
        f"T x 3, {_CELL}",
        "position of the object after the touch and a shift that follows it, as the published sets have it",
    ),
    "info.object_pose.quaternion": ("T x 4: x, y, z, w", "its orientation then"),
    "info.touched_object_pose.position": (f"T x 3, {_CELL}", "position of the object while it is touched"),
    "info.touched_object_pose.quaternion": ("T x 4: x, y, z, w", "its orientation then"),
    "pos_in_cell": (f"T x 2, {_CELL}", "where the gel goes"),
    "gel_pose_cell_frame.position": (f"T x 3, {_CELL}", "position of the sensor where it stops"),
    "gel_pose_cell_frame.quaternion": ("T x 4: x, y, z, w", "its orientation: z away from the plate"),
    "sensor_image": ("T images", "what the sensor sees"),
}

_OPTICS = {
    "depth": "the depth image, grey: black deepest in the gel, white no contact",
    "taxim": "Taxim with the calibration of the GelSight Mini, shadows included",
    "cyclegan": "a generator that was trained on real touches, from the depth image",
}


def write_card(folder: DataFolder, manifest: Manifest) -> None:
    """Write ``README.md`` of a data set folder and the picture that it shows.

    Raises IntegrityError when a shard is missing or damaged.
    """
    if manifest.spec.get("operation") == "pairs":
        lazy("tactile_sim.pairs.card:write_card")(folder, manifest)
        return
    facts = folder_facts(folder, manifest)
    spec = manifest.spec["options"]
    width, height = spec["size_px"]
    plan = spec["plan"]
    layer_m = spec.get("layer_m", 0.0)
    # A network shows the window of the size that it was trained in, whatever the pictures are scaled to.
    across, down = spec.get("weights_size_px", (width, height))
    window = "18.88 x 14.16" if spec["like"] == "published" else f"{14.16 * across / down:.4g} x 14.16"
    made = [
        made_by(manifest),
        ("optics", f"{spec['optics']}: {_OPTICS[spec['optics']]}"),
        ("window", f"{window} mm of gel, as in the {_like(spec['like'])}"),
        ("surface", f"printed, in layers of {1e3 * layer_m:g} mm" if layer_m else "as modelled"),
        ("noise", "of a real sensor, the last step on the finished picture" if spec.get("noise") else "none"),
        (
            "rounds of an object, touches of a round",
            f"{plan['rounds']}, {'at most ' if plan.get('given') else ''}{plan['touches']}",
        ),
        ("objects left out", skipped_text(manifest)),
    ]
    values = {
        "size_text": f"{width} x {height} pixels",
        "window_mm": window,
        "touches": f"{sum(_counts(manifest, split)['touches'] for split in manifest.splits):,}",
        "made": markdown_table(("", ""), made) + "\n\n" + json_block(manifest.spec),
        "follows": "the seed, the split, the object and the number of the round"
        + (", and the given touches," if plan.get("given") else ""),
        "limits": "\n".join(f"- {line}" for line in _limits(manifest)),
        "split_table": _split_table(facts, manifest),
        "field_table": field_table(facts, COLUMNS),
        "bibtex": bibtex("tactile_mnist"),
    }
    write_card_files(
        folder,
        facts,
        manifest,
        KIND.card_template,
        values,
        ("touches.png", _sheet(facts), "The first touches of the first rounds"),
        license="mit",
        pretty_name="Synthetic touches",
        task_categories=["robotics", "image-classification"],
        task_ids=["multi-class-image-classification"],
        tags=["tactile", "active-perception", "gelsight", "touch", "synthetic"],
    )


def _limits(manifest: Manifest) -> list[str]:
    spec = manifest.spec["options"]
    lacking = [
        "the wear of gels",
        *([] if spec.get("layer_m") else ["the texture of prints"]),
        *([] if spec.get("noise") else ["the noise of a camera"]),
    ]
    shown = f"Rendered images lack {' and '.join(lacking)}."
    if spec["optics"] == "cyclegan":
        shown = "What images show of prints, gels and noise is what the generator learned."
    counts = [_counts(manifest, split) for split in manifest.splits]
    touches, met = (sum(each[name] for each in counts) for name in ("touches", "on_object"))
    return [
        "No force, dynamics or tilt: the gel stops by geometry alone, and nothing moves while it is touched.",
        shown,
        *missed_text(touches - met, touches),
    ]


def _like(like: str) -> str:
    return "published data sets" if like == "published" else "published environments at this size"


def _counts(manifest: Manifest, split: str) -> dict[str, int]:
    # Counted by the shards: nothing that was written is read back.
    parts: list[Any] = [record.statistics for record in manifest.shards_of(split)]
    return {name: sum(part[name] for part in parts) for name in ("touches", "on_object")}


def _split_table(facts: FolderFacts, manifest: Manifest) -> str:
    rows = []
    for split in facts.splits:
        counts = _counts(manifest, split.split)
        share = f"{100 * counts['on_object'] / counts['touches']:.1f} %" if counts["touches"] else "-"
        sizes = len(split.paths), megabytes(split.file_bytes), megabytes(split.unpacked_bytes)
        rows.append((split.split, f"{split.rows:,}", f"{counts['touches']:,}", share, *sizes))
    return markdown_table(
        ("split", "rounds", "touches", "on the object", "shards", "Parquet", "unpacked"), rows
    )


def _sheet(facts: FolderFacts) -> bytes | None:
    """Draw the first touches of the first rounds, a round a row, as PNG."""
    rows = []
    for row in islice(first_rows(facts, ["sensor_image"]), _ROUNDS_SHOWN):
        images = row.value("sensor_image")[:_COLUMNS_SHOWN]
        rows.append(np.concatenate([tile(decode_image(each["bytes"])) for each in images], axis=1))
    widest = max((row.shape[1] for row in rows), default=0)  # given rounds may differ in length
    filled = [np.pad(row, ((0, 0), (0, widest - row.shape[1]), (0, 0)), constant_values=255) for row in rows]
    return png_bytes(np.concatenate(filled)) if rows else None
