"""The data card of a data set of scenes."""

from __future__ import annotations

import json

from dataset_store.cards import front_matter, markdown_table, render_card, write_card_text
from dataset_store.manifest import Manifest
from dataset_store.storage import DataFolder
from starstruck_gen.spec import SceneSpec
from starstruck_gen.summary import SplitSummary, summarise

__all__ = ["write_card"]

_RULES = {
    "circles": "the circumscribed circles of two objects never meet",
    "exact": "the outlines of two objects never touch",
}


def write_card(folder: DataFolder, manifest: Manifest) -> None:
    """Write ``README.md`` of a data set folder from its manifest.

    Raises
    ------
    StorageError
        When the folder cannot be written.
    """
    spec = SceneSpec.from_dict(manifest.spec["scene"])
    summaries = summarise(manifest)
    head = front_matter(
        manifest,
        license="mit",
        pretty_name="Starstruck",
        task_categories=["robotics", "reinforcement-learning"],
        tags=["tactile", "3d", "mesh", "counting"],
    )
    values = {
        "rows": f"{sum(summary.rows for summary in summaries):,}",
        "version": manifest.toolkit_version,
        "classes": ", ".join(spec.class_names),
        "shapes": _listed([shape.name for shape in spec.distractor_shapes]),
        "distractors": f"{spec.distractors[0]} to {spec.distractors[1]}",
        "rule": _rule(spec),
        "split_table": _split_table(summaries),
        "acceptance_table": _acceptance_table(summaries),
        "spec": json.dumps(manifest.spec, indent=2),
        "seed": str(manifest.spec["seed"]),
        "first_split": manifest.splits[0] if manifest.splits else "train",
    }
    write_card_text(folder, head + "\n" + render_card("starstruck.md", values))


def _rule(spec: SceneSpec) -> str:
    apart = f" and keep {1e3 * spec.clearance_m:g} mm" if spec.clearance_m else ""
    return _RULES[spec.collision] + apart


def _listed(names: list[str]) -> str:
    return ", ".join(dict.fromkeys(names)) or "none"


def _split_table(summaries: list[SplitSummary]) -> str:
    header = ("split", "scenes", "per class", "shards", "Parquet", "bytes per scene")
    rows = [
        (
            s.split,
            f"{s.rows:,}",
            ", ".join(f"{count:,}" for count in s.acceptance.classes),
            s.shards,
            f"{s.bytes / 1e6:.2f} MB",
            f"{s.bytes_per_scene:.0f}",
        )
        for s in summaries
    ]
    return markdown_table(header, rows)


def _acceptance_table(summaries: list[SplitSummary]) -> str:
    header = ("split", "positions drawn per object (first, second, ...)", "accepted", "scenes started over")
    rows = [
        (
            s.split,
            ", ".join(f"{mean:.2f}" for mean in s.acceptance.attempts_per_object),
            f"{100 * s.acceptance.accepted:.1f} %",
            s.acceptance.restarts,
        )
        for s in summaries
    ]
    return markdown_table(header, rows)
