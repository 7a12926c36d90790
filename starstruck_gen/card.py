"""The data card of a data set of scenes."""

from __future__ import annotations

import math

from starstruck_gen.card_picture import PREVIEW_FILE, scene_sheet
from starstruck_gen.rows import scene_schema
from starstruck_gen.spec import SceneSpec
from starstruck_gen.streams import SPLITS, scene_id
from starstruck_gen.summary import SplitSummary, summarise
from tactile_toolkit.cards.card import (
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
from tactile_toolkit.cards.facts import FolderFacts, recorded_facts
from tactile_toolkit.cards.head import card_head, head_text
from tactile_toolkit.cards.pictures import write_previews
from tactile_toolkit.mesh.columns import FACES, VERTICES
from tactile_toolkit.store.folder import DataFolder
from tactile_toolkit.store.manifest import Manifest
from tactile_toolkit.wording import counted

__all__ = ["write_card"]

_RULES = {
    "circles": "the circumscribed circles of two objects do not meet",
    "exact": "the outlines of two objects do not touch",
}

_COLUMNS: dict[str, Column] = {
    "id": ("", f"number of the scene: from 0 in train, from {scene_id(SPLITS[1], 0):,} in test"),
    "label": ("", "the class, named by the number of stars"),
    VERTICES: ("V x 3, m, frame below", "corner positions"),
    FACES: ("F x 3", "triangles: rows of the corners, counter-clockwise seen from outside"),
    "star_count": ("", "number of stars"),
    "distractor_count": ("", "number of objects that are no stars"),
    "placements": (
        "one per object: m, rad, frame below",
        "each object in the order of placing, stars first: `shape`, centre `x_m` and `y_m`, `angle_rad` "
        "about z, `radius_m` of the circumscribed circle, `height_m`",
    ),
    "seed": ("", "seed of the scene: with the specification and the star count it makes the scene again"),
    "attempts": ("one per object", "positions drawn for it"),
    "restarts": ("", "how often the scene was started over"),
}


def write_card(folder: DataFolder, manifest: Manifest, _report: object = None) -> None:
    """Write ``README.md`` of a data set folder and the picture that it shows; scenes have no report.

    Raises IntegrityError when a shard is missing or damaged.
    """
    spec = SceneSpec.from_dict(manifest.spec["scene"])
    facts = recorded_facts(folder, manifest, scene_schema(spec.class_names))
    sheet = scene_sheet(facts, spec.cell_m)
    if sheet is not None:
        write_previews(folder, {PREVIEW_FILE: sheet})
    head = card_head(
        facts,
        license="mit",
        pretty_name="Starstruck",
        task_categories=["robotics", "reinforcement-learning"],
        task_ids=["task-planning"],
        tags=["tactile", "active-perception", "3d", "mesh", "counting"],
    )
    body = render_card("starstruck.md", _values(manifest, spec, facts, sheet is not None))
    write_card_text(folder, head_text(head) + "\n" + body)


def _values(manifest: Manifest, spec: SceneSpec, facts: FolderFacts, drawn: bool) -> dict[str, str]:
    summaries = summarise(manifest)
    return {
        "rows": f"{facts.rows:,}",
        "picture": picture(PREVIEW_FILE if drawn else None, "The first scenes from above; stars are orange"),
        "version": manifest.toolkit_version,
        "schema_version": str(manifest.schema_version),
        "seed": str(manifest.spec["seed"]),
        "cell_mm": " x ".join(f"{1e3 * side:g}" for side in spec.cell_m),
        "reach_x_mm": f"{1e3 * spec.half_area_m[0]:g}",
        "reach_y_mm": f"{1e3 * spec.half_area_m[1]:g}",
        "classes": ", ".join(spec.class_names),
        "class_count": str(len(spec.class_names)),
        "distractors": _distractors(spec),
        "shapes": _shapes(spec),
        "rotation": _rotation(spec),
        "heights": " or ".join(f"{1e3 * height:g}" for height in spec.heights_m) + " mm",
        "rule": _rule(spec),
        "attempts": f"{spec.attempts:,}",
        "spec": json_block(manifest.spec),
        "split_table": _split_table(summaries, facts),
        "field_table": field_table(facts, _COLUMNS, {}),
        "acceptance_table": _acceptance_table(summaries),
        "print_text": _print_text(spec),
        "limits": _limits(manifest, spec),
        "first_split": facts.splits[0].split,
        "bibtex": bibtex(TACTILE_MNIST),
    }


def _distractors(spec: SceneSpec) -> str:
    least, most = spec.distractors
    return counted(most, "objects") if least == most else f"{least:,} to {most:,} objects"


def _rule(spec: SceneSpec) -> str:
    apart = f" and keep {1e3 * spec.clearance_m:g} mm" if spec.clearance_m else ""
    return _RULES[spec.collision] + apart


def _shapes(spec: SceneSpec) -> str:
    return ", ".join(dict.fromkeys(shape.key for shape in spec.distractor_shapes)) or "none"


def _rotation(spec: SceneSpec) -> str:
    turned = math.degrees(spec.rotation_rad)
    return f" by 0 to {turned:g} degrees about z" if turned else " by 0 degrees"


def _split_table(summaries: list[SplitSummary], facts: FolderFacts) -> str:
    header = ("split", "scenes", "per class", "shards", "Parquet", "bytes per scene", "unpacked")
    rows = [
        (
            s.split,
            f"{s.rows:,}",
            ", ".join(f"{count:,}" for count in s.acceptance.classes),
            s.shards,
            megabytes(s.bytes),
            f"{s.bytes_per_scene:,.0f}",
            megabytes(split.unpacked_bytes),
        )
        for s, split in zip(summaries, facts.splits, strict=True)
    ]
    return markdown_table(header, rows)


def _acceptance_table(summaries: list[SplitSummary]) -> str:
    header = ("split", "positions drawn per object (first, second, ...)", "accepted", "scenes started over")
    rows = [
        (
            s.split,
            ", ".join(f"{mean:.2f}" for mean in s.acceptance.attempts_per_object),
            f"{100 * s.acceptance.accepted:.1f} %",
            f"{s.acceptance.restarts:,}",
        )
        for s in summaries
    ]
    return markdown_table(header, rows)


def _print_text(spec: SceneSpec) -> str:
    radii = sorted({shape.radius_m for shape in (spec.star, *spec.distractor_shapes)})
    sizes = " to ".join(dict.fromkeys(f"{2e3 * radius:g}" for radius in (radii[0], radii[-1])))
    return f"The circles around them are {sizes} mm wide; a scene prints as loose objects."


def _limits(manifest: Manifest, spec: SceneSpec) -> str:
    lines = [
        "Objects lie flat and are of one height each; nothing is stacked.",
        "Scenes are drawn anew from the seed: they are not the published scenes, only made by the same rule.",
    ]
    if spec.to_dict() != SceneSpec().to_dict():
        lines.append("The specification is not the published one; results do not compare with the paper's.")
    if manifest.spec["limit"] is not None:
        lines.append(f"Splits are cut to their first {manifest.spec['limit']:,} scenes.")
    return "\n".join(f"- {line}" for line in lines)
