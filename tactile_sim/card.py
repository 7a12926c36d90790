"""The data card of a data set of synthetic touches."""

from __future__ import annotations

from collections.abc import Mapping
from itertools import islice
from typing import Any

import numpy as np

from tactile_sim.columns import TouchRow
from tactile_sim.kind import KIND
from tactile_sim.sheets import tile
from tactile_toolkit.cards.card import Card, first_rows
from tactile_toolkit.cards.facts import FolderFacts, folder_facts
from tactile_toolkit.kind import lazy
from tactile_toolkit.pictures.writing import png_bytes
from tactile_toolkit.rows import meanings
from tactile_toolkit.store.folder import DataFolder
from tactile_toolkit.store.manifest import Manifest
from tactile_toolkit.touch.contact import missed_text
from tactile_toolkit.touch.jpeg import decode_image

_COLUMNS_SHOWN = 8
_ROUNDS_SHOWN = 4

_OPTICS = {
    "depth": "the depth image, grey: black deepest in the gel, white no contact",
    "taxim": "Taxim with the calibration of the GelSight Mini, shadows included",
    "cyclegan": "a generator that was trained on real touches, from the depth image",
}
_LIKE = {"published": "published data sets", "environment": "published environments at this size"}


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
    statistics = manifest.statistics()  # counted by the shards: nothing that was written is read back
    counts = [statistics[split] for split in manifest.splits]
    touches, met = (sum(each[name] for each in counts) for name in ("touches", "on_object"))
    Card(
        template=KIND.card_template,
        title="Synthetic touches",
        columns=meanings(TouchRow),
        picture=("touches.png", _sheet(facts), "The first touches of the first rounds"),
        licence="mit",
        tags=["tactile", "active-perception", "gelsight", "touch", "synthetic"],
        tasks={
            "task_categories": ["robotics", "image-classification"],
            "task_ids": ["multi-class-image-classification"],
        },
        figures={
            "touches": [f"{each['touches']:,}" for each in counts],
            "on the object": [
                f"{100 * each['on_object'] / each['touches']:.1f} %" if each["touches"] else "-"
                for each in counts
            ],
        },
        made=[
            ("optics", f"{spec['optics']}: {_OPTICS[spec['optics']]}"),
            ("window", f"{window} mm of gel, as in the {_LIKE[spec['like']]}"),
            ("surface", f"printed, in layers of {1e3 * layer_m:g} mm" if layer_m else "as modelled"),
            ("noise", "of a real sensor, added to the finished picture" if spec.get("noise") else "none"),
            (
                "rounds of an object, touches of a round",
                f"{plan['rounds']}, {'at most ' if plan.get('given') else ''}{plan['touches']}",
            ),
        ],
        values={
            "size_text": f"{width} x {height} pixels",
            "window_mm": window,
            "touches": f"{touches:,}",
            "follows": "the seed, the split, the object and the number of the round"
            + (", and the given touches," if plan.get("given") else ""),
            "limits": "\n".join(f"- {line}" for line in _limits(spec, touches, met)),
        },
    ).write(folder, facts, manifest, KIND)


def _limits(spec: Mapping[str, Any], touches: int, met: int) -> list[str]:
    lacking = [
        "the wear of gels",
        *([] if spec.get("layer_m") else ["the texture of prints"]),
        *([] if spec.get("noise") else ["the noise of a camera"]),
    ]
    shown = f"Rendered images lack {' and '.join(lacking)}."
    if spec["optics"] == "cyclegan":
        shown = "What images show of prints, gels and noise is what the generator learned."
    return [
        "No force, dynamics or tilt: the gel stops by geometry alone, and nothing moves while it is touched.",
        shown,
        *missed_text(touches - met, touches),
    ]


def _sheet(facts: FolderFacts) -> bytes | None:
    """Draw the first touches of the first rounds, a round a row, as PNG."""
    rows = []
    for row in islice(first_rows(facts, ["sensor_image"]), _ROUNDS_SHOWN):
        images = row.value("sensor_image")[:_COLUMNS_SHOWN]
        rows.append(np.concatenate([tile(decode_image(each["bytes"])) for each in images], axis=1))
    widest = max((row.shape[1] for row in rows), default=0)  # given rounds may differ in length
    filled = [np.pad(row, ((0, 0), (0, widest - row.shape[1]), (0, 0)), constant_values=255) for row in rows]
    return png_bytes(np.concatenate(filled)) if rows else None
