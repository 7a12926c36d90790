"""Text about the gel in the card of a data set of touches: pressed to one depth, or elastic."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from itertools import islice

import numpy as np

from tactile_sim.kind import KIND
from tactile_sim.press.sensors import GELSIGHT_MINI, SensorModel, sensor_of_model
from tactile_sim.sets.generation import SyntheticRound
from tactile_sim.sets.pairs import PairRow, decode_depth
from tactile_sim.sets.set_options import WINDOWS
from tactile_toolkit import cards, store, touch, wording
from tactile_toolkit.kind import Facts
from tactile_toolkit.pictures import Tile, sheet
from tactile_toolkit.value_types import AnyArray, JsonObject, UInt8

_RIGID_LIMIT = (
    "No force, dynamics or tilt: the gel stops by geometry only, and nothing moves while it is touched."
)
_ELASTIC_LIMITS = (
    "No tilt. The gel is a linear elastic layer without side faces: no viscosity, no adhesion, no large "
    "strain; a press of half the thickness, where one by force stops, is indicative only.",
    "A slide and a twist are applied in one step after the press; real contact depends on its history.",
)
_GRASP_LIMITS = (
    "The gel is a linear elastic layer without side faces: no viscosity, no adhesion, no large strain, and "
    "one coefficient of friction.",
    "Fingers do not collide with the object beside their gels.",
)

# Approximate width of images in sheets.
_TILE_PX = 96
_COLUMNS_SHOWN = 8
_ROUNDS_SHOWN = 4

_OPTICS = {
    "depth": "the depth image, grey: black deepest in the gel, white no contact",
    "taxim": "Taxim with the calibration of the GelSight Mini, shadows included",
    "cyclegan": "a generator that was trained on real touches, from the depth image",
    "twin": "the twin of a sensor, which `tactile-sim calibrate` made from its touches",
}

_TASKS = {
    "task_categories": ["robotics", "image-classification"],
    "task_ids": ["multi-class-image-classification"],
}
_LIKE = {"published": "published data sets", "environment": "published environments at this size"}
_NOISE = ("of a real sensor, added to the finished image", "as stated below, added to the finished image")
_DECODERS: dict[str, Callable[[bytes], AnyArray]] = {"depth": decode_depth, "real": touch.decode_image}


@dataclass(frozen=True)
class CardGel:
    """Texts of a card: stop of the sensor, surface that images show, further columns, table, limits."""

    stops: str
    shown: str
    more: str
    lines: Sequence[tuple[str, str]]
    limits: Sequence[str]

    @classmethod
    def of(cls, spec: JsonObject) -> CardGel:
        """Return the words for a specification, as its manifest states it."""
        press = spec.get("press")
        if press is None:
            return cls("", "depth", "", (), (_RIGID_LIMIT,))
        stops = f"the force is {_span(press['force_n'], 1.0)} N, or half of the gel is pressed in"
        if press["force_n"] is None:
            stops = f"the highest point under it is {_span(press['press_m'], 1e3)} mm deep in it"
        lines = [("gel", f"{_material(press)}, friction {press['friction']:g}")]
        for what, name, factor, unit in (
            ("slide after the press", "slide_m", 1e3, "mm"),
            ("twist after the press", "twist_rad", 180 / math.pi, "degrees"),
        ):
            if any(press[name]):
                lines.append((what, f"{_span(press[name], factor)} {unit}"))
        if press["markers"] is not None:
            drawn = "not drawn" if not press["draw_markers"] else "drawn into the images"
            columns, rows = press["markers"]
            lines.append(("markers", f"{columns} columns, {rows} rows, {drawn}"))
        more = (
            "the pose of the object during the touch, `plate_z_m`, and what the gel feels, which "
            '`touch.extra["force_n"]` and so on read'
        )
        return cls(stops, "the surface of the gel", more, lines, _ELASTIC_LIMITS)


def _material(press: JsonObject) -> str:
    modulus_mpa = press["youngs_modulus_pa"] / 1e6
    return f"elastic: Young's modulus {modulus_mpa:g} MPa, Poisson's ratio {press['poisson_ratio']:g}"


def _span(ends: Sequence[float], factor: float) -> str:
    low, high = (f"{factor * end:.4g}" for end in ends)
    return low if low == high else f"{low} to {high}"


def write_card(folder: store.DataFolder, manifest: store.Manifest) -> None:
    """Write ``README.md`` of a data set folder and its picture.

    Raises IntegrityError if a shard is missing or damaged.
    """
    write = _CARDS.get(str(manifest.spec.get("operation")), _write_touches_card)
    write(folder, manifest)


def _write_touches_card(folder: store.DataFolder, manifest: store.Manifest) -> None:
    spec = manifest.spec["options"]
    width, height = spec["size_px"]
    plan = spec["plan"]
    layer_m = spec.get("layer_m", 0.0)
    sensor = _sensor_of(spec)
    gel = CardGel.of(spec)
    statistics = manifest.statistics()  # counted while the shards were made
    counts = [statistics[split] for split in manifest.splits]
    touches, on_object = (sum(row[name] for row in counts) for name in ("touches", "on_object"))
    cards.Card(
        template=KIND.card_template,
        title="Synthetic touches",
        columns=SyntheticRound.meanings(),
        picture=("touches.png", "The first touches of the first rounds"),
        drawn=touches_sheet,
        licence="mit",
        tags=["tactile", "active-perception", touch.sensor_family(sensor.model.name), "touch", "synthetic"],
        tasks=_TASKS,
        figures={
            "touches": [f"{row['touches']:,}" for row in counts],
            "on the object": [
                f"{100 * row['on_object'] / row['touches']:.1f} %" if row["touches"] else "-"
                for row in counts
            ],
        },
        made=[
            *_objects_in_words(manifest.spec["source"]),
            ("optics", f"{spec['optics']}: {_OPTICS[spec['optics']]}"),
            *sensor.lines,
            *gel.lines,
            ("surface", f"printed, in layers of {1e3 * layer_m:g} mm" if layer_m else "as modelled"),
            ("noise", _NOISE[spec["optics"] == "depth"] if spec.get("noise") else "none"),
            (
                "rounds of an object, touches of a round",
                f"{plan['rounds']}, {'at most ' if plan.get('given') else ''}{plan['touches']}",
            ),
        ],
        limits=_limits(spec, gel, touches, on_object),
        values={
            "size_text": f"{width} x {height} pixels",
            "sensor": sensor.name,
            "gel_mm": f"{sensor.model.gel_mm:g}",
            "stops": gel.stops
            or f"the highest point under it is {1e3 * sensor.model.press_m:g} mm deep in it",
            "shown": gel.shown,
            "window_mm": sensor.window_mm,
            "more": gel.more or sensor.more,
            "touches": f"{touches:,}",
            "follows": "the seed, the split, the object and the number of the round"
            + (", and the given touches," if plan.get("given") else ""),
        },
    ).write(folder, manifest, KIND)


@dataclass(frozen=True)
class _CardSensor:
    """Texts about the sensor in a card; ``lines`` belong to the table of how the set was made."""

    model: SensorModel
    name: str
    window_mm: str
    lines: list[tuple[str, str]]

    @property
    def more(self) -> str:
        """The columns that the published schema does not have."""
        more = "one more column: the pose of the object during the touch"
        if self.model.press_m == touch.PRESS_DEPTH_M:
            return more
        return f"{more}; and `plate_z_m`, the height of the sensor on the bare plate"


def _sensor_of(spec: JsonObject) -> _CardSensor:
    size_px = spec["size_px"]
    like = spec["like"]
    if "sensor" in spec:
        geometry = SensorModel.geometry_names()
        model = SensorModel(**{name: spec["sensor"][name] for name in geometry})
        (window,) = (name for name, stored in WINDOWS.items() if stored == like)
        sides_mm = [1e3 * side_m for side_m in sensor_of_model(model, window, tuple(size_px)).window_m]
        shown = " x ".join(f"{side_mm:.4g}" for side_mm in sides_mm)
        name, source = map(wording.markdown_text, (model.name, model.source or "no source is stated"))
        area = f"{shown} mm of the {model.width_mm:g} x {model.height_mm:g} mm of the gel"
        lines = [("sensor", f"{name}, by its geometry; {source}"), ("window", area)]
        return _CardSensor(model, f"sensor ({name})", shown, lines)
    # A network shows the window of the size that it was trained in, whatever the images are scaled to.
    across, down = spec.get("weights_size_px", size_px)
    shown = "18.88 x 14.16" if like == "published" else f"{14.16 * across / down:.4g} x 14.16"
    lines = [("window", f"{shown} mm of gel, as in the {_LIKE[like]}")]
    return _CardSensor(GELSIGHT_MINI, "GelSight Mini", shown, lines)


def _objects_in_words(source: Mapping[str, Sequence[JsonObject]]) -> list[tuple[str, str]]:
    """Return a line about the mesh files or meshes that were touched; none for those of a data set."""
    files = [file for listed in source.values() for file in listed if not file["file"].endswith(".parquet")]
    if not files:
        return []
    units = sorted({file["unit"] for file in files if "unit" in file})
    words = f"{wording.with_count(len(files), 'meshes')}, numbered as `manifest.json` lists them"
    if units:
        words += f"; STL, PLY and OBJ are in {units[0]}"
    return [("objects", words)]


def _limits(spec: JsonObject, gel: CardGel, touches: int, on_object: int) -> list[str]:
    lacking = ["the wear of gels"]
    if not spec.get("layer_m"):
        lacking.append("the texture of prints")
    if not spec.get("noise"):
        lacking.append("the noise of a camera")
    shown = f"Rendered images lack {' and '.join(lacking)}."
    if spec["optics"] == "cyclegan":
        shown = "Images show prints, gels and noise as the generator learned them."
    return [
        *gel.limits,
        shown,
        *touch.HeightRule(touch.HeightRule.RENDERED_M, "known").missed_lines(touches - on_object, touches),
    ]


def touches_sheet(facts: cards.FolderSummary) -> bytes | None:
    """Draw the first touches of the first rounds as PNG, a row for each round."""
    rounds = islice(facts.first_rows(["sensor_image"]), _ROUNDS_SHOWN)
    shown = (row.value("sensor_image")[:_COLUMNS_SHOWN] for row in rounds)
    rows = [
        (f"round {number}", [touch.decode_image(stored["bytes"]) for stored in images])
        for number, images in enumerate(shown)
    ]
    if not rows:
        return None
    return sheet_png(rows)


def _write_grasps_card(folder: store.DataFolder, manifest: store.Manifest) -> None:
    """Write ``README.md`` of a set of lift attempts and its picture."""
    spec = manifest.spec["options"]
    width, height = spec["size_px"]
    counts = [manifest.statistics()[split] for split in manifest.splits]
    sensor, press = _sensor_of(spec), spec["press"]
    spans = (("force of each finger", press["force_n"], 1.0, " N"), ("mass", spec["mass_kg"], 1e3, " g"))
    cards.Card(
        template="touch_grasps.md",
        title="Lift attempts",
        columns=SyntheticRound.meanings(),
        picture=("touches.png", "The first touches of the first attempts, left and right gel in turn"),
        drawn=touches_sheet,
        licence="mit",
        tags=["tactile", "grasping", "slip-detection", "touch", "synthetic"],
        tasks={"task_categories": ["robotics", "image-classification"]},
        figures={"held": [f"{row['held']:,}" for row in counts]},
        made=[
            *_objects_in_words(manifest.spec["source"]),
            ("optics", f"{spec['optics']}: {_OPTICS[spec['optics']]}"),
            *sensor.lines,
            ("gel", _material(press)),
            *((what, f"{_span(ends, factor)}{unit}") for what, ends, factor, unit in spans),
            ("friction", _span(spec["friction"], 1.0)),
            ("noise", _NOISE[spec["optics"] == "depth"] if spec.get("noise") else "none"),
        ],
        limits=_GRASP_LIMITS,
        values={
            "size_text": f"{width} x {height} pixels",
            "gel_mm": f"{sensor.model.gel_mm:g}",
            "gels": "both gels, the left one first," if spec["plan"]["fingers"] == 2 else "the left gel",
            "touches": f"{sum(row['touches'] for row in counts):,}",
        },
    ).write(folder, manifest, KIND)


def _write_pairs_card(folder: store.DataFolder, manifest: store.Manifest) -> None:
    """Write ``README.md`` of a training set and its picture."""
    spec = manifest.spec["options"]
    width, height = spec["size_px"]
    counts = manifest.statistics()
    cards.Card(
        template="touch_pairs.md",
        title="Unpaired depth images and touches",
        columns=PairRow.meanings(),
        picture=("pairs.png", "Depth images above, touches below; they do not belong together"),
        drawn=_pairs_sheet,
        licence="other",
        tags=["tactile", "gelsight", "touch", "cyclegan"],
        tasks={"task_categories": ["image-to-image", "robotics"]},
        figures={"with contact": [f"{counts[split]['on_object']:,}" for split in manifest.splits]},
        made=[
            ("without contact, asked for", f"{100 * spec['without_contact']:.4g} % of each split"),
            ("contact", touch.HeightRule(spec["min_height_m"], "known").height_text),
        ],
        values={"size_text": f"{width} x {height} pixels"},
    ).write(folder, manifest, KIND)


def _pairs_sheet(facts: cards.FolderSummary) -> bytes:
    """Draw the first rows of both splits, one above the other, as PNG."""
    rows = []
    for split in facts.splits:
        block = next(split.shards[0].blocks(0, ["sensor_image"]))
        images = block.table.column(0)[:_COLUMNS_SHOWN].to_pylist()
        rows.append((split.split, [_DECODERS[split.split](image["bytes"]) for image in images]))
    return sheet_png(rows)


def sheet_png(rows: Sequence[tuple[str, Sequence[AnyArray] | AnyArray]]) -> bytes:
    """Draw rows of images, each with a caption: uint8 colours (H, W, 3), or depth from 0 to 1 (H, W).

    Shows every n-th pixel, or each pixel n times; nothing is smoothed.
    """
    tiles = [Tile(_shown(picture), group=word) for word, pictures in rows for picture in pictures]
    columns = max(len(pictures) for _, pictures in rows)
    return touch.encode_image(sheet(tiles, columns, gap_px=2, margin_px=2), "png")


def _shown(picture: AnyArray) -> UInt8:
    if picture.ndim == 2:
        picture = np.rint(np.clip(picture, 0, 1) * 255).astype(np.uint8)
    times = -(-_TILE_PX // picture.shape[1])
    step = max(1, picture.shape[1] // _TILE_PX)
    return picture[::step, ::step].repeat(times, axis=0).repeat(times, axis=1)


def facts(_folder: store.DataFolder, manifest: store.Manifest) -> Facts:
    """Return the touches of each split, and how many met an object; reads no row."""
    rows = []
    figure, noun = ("held", "rows") if manifest.spec.get("operation") == "grasp" else ("on_object", "touches")
    for split, held in manifest.split_table().items():
        # Shard records hold these counts.
        parts = [record.statistics or {} for record in manifest.shards_of(split)]
        touches, counted = (sum(part.get(name, 0) for part in parts) for name in ("touches", figure))
        total = {"rows": held["rows"], "touches": touches}[noun]
        share = f"{100 * counted / total:.1f} %" if total else "-"
        size_text = wording.bytes_text(held["bytes"])
        rows.append((split, held["rows"], touches, share, held["skipped"], size_text))
    title = {"held": "held", "on_object": "on the object"}[figure]
    header = ("split", "rounds", "touches", title, "objects left out", "Parquet")
    return Facts(header, tuple(rows))


_CARDS = {"pairs": _write_pairs_card, "grasp": _write_grasps_card}
