"""The data card, previews and the gallery of scenes."""

from __future__ import annotations

import math
from functools import partial

import pyarrow as pa

from starstruck_gen import kind, sampling, scene_dataset
from tactile_toolkit import cards, gallery, mesh, rows, store, wording
from tactile_toolkit.kind import Facts
from tactile_toolkit.value_types import JsonDict

_RULES = {
    "circles": "the circumscribed circles of two objects do not meet",
    "exact": "the outlines of two objects do not touch",
}
COLUMNS = scene_dataset.SceneRow.meanings()

_SHOWN = (
    *scene_dataset.SceneRow.with_role("facet", "measure"),
    rows.Column(pa.list_(pa.string()), name="shapes", role="facet", title="Shapes"),
    rows.Column(pa.int64(), name="objects", role="measure", title="Objects"),
    rows.Column(pa.int64(), name="positions", role="measure", title="Positions drawn"),
    *(mesh.PrintReport.columns()[name] for name in ("volume_mm3", "vertices", "faces")),
)


def write_card(folder: store.DataFolder, manifest: store.Manifest) -> None:
    """Write ``README.md`` of a data set folder, and the picture in it.

    Raises IntegrityError when a shard is missing or damaged.
    """
    if manifest.is_copy:
        licence = "mit"
        text = "MIT, as the toolkit."
        if not manifest.made_by:
            licence = "other"
            text = "The terms of the data set that these rows come from."
        terms = {"licence_text": text, "citation_text": "The task: Schneider et al. 2025."}
        card = cards.Card.of_copy(manifest, kind.KIND, "Starstruck", COLUMNS, licence, **terms)
        card.write(folder, manifest, kind.KIND)
        return
    spec = sampling.SceneSpec.from_dict(manifest.spec["scene"])
    cards.Card(
        template=kind.KIND.card_template,
        title="Starstruck",
        columns=COLUMNS,
        picture=("scenes.png", "The first scenes of each class from above; stars are orange"),
        drawn=scene_dataset.SceneRecord,
        licence="mit",
        tags=["tactile", "active-perception", "3d", "mesh", "counting"],
        limits=_limits(manifest, spec),
        values={
            **_placement_values(spec),
            "seed": str(manifest.spec["seed"]),
        },
    ).write(folder, manifest, kind.KIND)


def _placement_values(spec: sampling.SceneSpec) -> dict[str, str]:
    """Describe the specification in words, with sizes in millimetres."""
    least, most = spec.distractors
    turned = math.degrees(spec.rotation_rad)
    radii = sorted({shape.radius_m for shape in (spec.star, *spec.distractor_shapes)})
    widths = " to ".join(dict.fromkeys(f"{2e3 * radius:g}" for radius in (radii[0], radii[-1])))
    rule = _RULES[spec.collision]
    rotation = " by 0 degrees"
    if spec.clearance_m:
        rule = f"{rule} and keep {1e3 * spec.clearance_m:g} mm"
    if turned:
        rotation = f" by 0 to {turned:g} degrees about z"
    distractors = wording.with_count(most, "objects")
    if least < most:
        distractors = f"{least:,} to {most:,} objects"
    return {
        "cell_mm": " x ".join(f"{1e3 * side:g}" for side in spec.cell_m),
        "reach_x_mm": f"{1e3 * spec.half_area_m[0]:g}",
        "reach_y_mm": f"{1e3 * spec.half_area_m[1]:g}",
        "classes": ", ".join(map(wording.markdown_text, spec.class_names)),
        "class_count": str(len(spec.class_names)),
        "distractors": distractors,
        "shapes": ", ".join(dict.fromkeys(shape.key for shape in spec.distractor_shapes)) or "none",
        "rotation": rotation,
        "heights": " or ".join(f"{1e3 * height:g}" for height in spec.heights_m) + " mm",
        "rule": rule,
        "attempts": f"{spec.attempts:,}",
        "print_text": f"The circles around them are {widths} mm wide; a scene prints as loose objects.",
    }


def _limits(manifest: store.Manifest, spec: sampling.SceneSpec) -> list[str]:
    lines = [
        "Objects lie flat and are of one height each; nothing is stacked.",
        "Scenes are drawn from the seed: they are not the published scenes, only made by the same rule.",
    ]
    if spec.to_dict() != sampling.SceneSpec().to_dict():
        lines.append("The specification is not the published one; results do not compare with the paper's.")
    if manifest.spec["limit"] is not None:
        lines.append(f"Splits are cut to their first {manifest.spec['limit']:,} scenes.")
    return lines


def _facts(record: scene_dataset.SceneRecord, _known: None) -> JsonDict:
    if not record.has_placements:
        return {}
    return {
        "shapes": sorted({placement.shape for placement in record.placements}),
        "objects": len(record.placements),
        "positions": sum(record.scene.attempts),
    }


plan_gallery = partial(
    gallery.Gallery.of_solids, kind.KIND, title="Starstruck scenes", columns=_SHOWN, facts=_facts
)


def facts(_folder: store.DataFolder, manifest: store.Manifest) -> Facts:
    """Return the splits of a data set as a list, for JSON."""
    splits = [{"split": name, **counts} for name, counts in manifest.split_table().items()]
    return Facts(document={"splits": splits})
