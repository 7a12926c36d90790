"""``tactile-sim``: press a simulated GelSight Mini onto solids, and make data sets of its touches."""

from __future__ import annotations

import math
import os
from dataclasses import MISSING, fields
from functools import partial
from pathlib import Path
from typing import Annotated, Any, Literal

import tactile_sim
from cli.application import command, new_app, run as run_app
from cli.calibration import calibrate
from cli.checks import Objects
from cli.declared_options import OptionsOf
from cli.galleries import gallery_of_touches
from cli.options import Making, Opening, argument, local_out_folder, local_place, out_folder
from cli.output import Sink
from cli.previews import preview_touches
from cli.runs import generate_set, print_set
from cli.sensor_twins import check, download_sensor, show_sensor, upload_sensor
from cli.shared import add_shared
from tactile_sim import SENSOR_NOISE, ElasticPress, GenerateSpec, PairsSpec, TouchPlan, TrainConfig
from tactile_sim.kind import KIND
from tactile_sim.sensor_models import GELSIGHT_MINI
from tactile_toolkit import mesh, run, store, touch
from tactile_toolkit.catalog import INCOMPLETE, RowFilter
from tactile_toolkit.checked_fields import choice, integer, option_name, real, switch, text
from tactile_toolkit.errors import InputError
from tactile_toolkit.kind import DatasetKind
from tactile_toolkit.quantities import bytes_text
from tactile_toolkit.wording import with_count

app = new_app("tactile-sim", "Synthetic touches: press a simulated GelSight Mini onto any solid.")

_ENDINGS: dict[str, Literal["jpeg", "png"]] = {".png": "png", ".jpg": "jpeg", ".jpeg": "jpeg"}


@command(app)
def generate(
    *,
    objects: str = argument("FILE|DIR|NAME", "Mesh file, folder of mesh files, or data set of meshes."),
    opening: Opening,
    chosen: RowFilter,
    unit: str | None = mesh.UNIT,
    out: str = out_folder("touches"),
    plan: Annotated[dict[str, Any], OptionsOf(TouchPlan)],
    picture: Annotated[dict[str, Any], OptionsOf(GenerateSpec)],
    press: Annotated[dict[str, Any], OptionsOf(ElasticPress)],
    making: Making,
    sink: Sink,
) -> None:
    """Press the gel onto the objects of a data set, or onto your own, and write a data set of touches.

    Example: tactile-sim generate digits --split test --rounds 1 --touches 32 --out touches

    Example: tactile-sim generate part.stl --positions object --sensor digit --optics depth --out touches

    Example: tactile-sim generate digits --gel elastic --force-n 1:10 --slide-mm 0:0.5 --markers 7x9

    In a folder of mesh files, each sub-folder is a class, or each file; train and test are splits.

    After an interruption, the same command continues; finished shards are kept.
    """
    # A table of positions implies `given` in place of the default `cell`; other values are refused.
    if "given" in plan and plan.get("positions", "cell") == "cell":
        plan["positions"] = "given"
    given = chosen.given()
    split = given.pop("split")
    splits = split and (split,)
    spec = _spec_of(sink, picture, plan=TouchPlan(**plan), press=_press_of(press), **given)
    if not making.dry_run:
        run.prepare_batch_process()
    touches = tactile_sim.TouchGenerator.of(objects, spec, unit, partial(opening.open, sink))
    if touches.has_own_objects and opening != Opening():
        raise InputError(
            f"--revision, --config-name and --allow-incomplete are for data sets, and {objects!r} is "
            "of mesh files",
            next="leave them out",
        )
    require = partial(touches.refuse_sources, objects, out)
    generate_set(sink, "rendering", touches, out, splits, making, _print_made, require)


def _spec_of(sink: Sink, picture: dict[str, Any], **others: Any) -> GenerateSpec:
    """Return the specification of the options that were given."""
    known, optics = "optics" in picture, tactile_sim.default_optics()
    sensor = picture.get("sensor", GELSIGHT_MINI)
    if sensor != GELSIGHT_MINI:
        known, optics = True, sensor.optics_name
    spec = GenerateSpec(**{"optics": optics, **picture, **others})
    if not known and spec.optics == "depth":
        sink.info("note: images are depth images; --optics taxim needs the extra `sim`")
    return spec


def _press_of(given: dict[str, Any]) -> ElasticPress | None:
    """Return the press of the options that were given; InputError for those of a gel that is not elastic."""
    if given.get("gel") is not None:
        return ElasticPress(**given)
    names = {each.name: option_name(each) for each in fields(ElasticPress)}
    others = [names[name] for name in given if name != "gel"]
    if others:
        raise InputError(
            f"{others[0]} is given, and the gel is not elastic: its presses have one depth and no force",
            next="add --gel elastic, or leave it out",
        )
    return None


def _print_made(
    sink: Sink, kind: DatasetKind, manifest: store.Manifest, out: str, elapsed_s: float | None
) -> None:
    rows = []
    for split, held in manifest.split_table().items():
        # Shard records hold these counts, so no row is read.
        parts = [record.statistics or {} for record in manifest.shards_of(split)]
        touches, contact = (sum(part.get(name, 0) for part in parts) for name in ("touches", "on_object"))
        share = "-"
        if touches:
            share = f"{100 * contact / touches:.1f} %"
        rows.append((split, held["rows"], touches, share, held["skipped"], bytes_text(held["bytes"])))
    header = ("split", "rounds", "touches", "on the object", "objects left out", "Parquet")
    print_set(sink, kind, manifest, out, elapsed_s, header, rows)


def _place_m(words: str) -> tuple[float, float] | None:
    """Read ``x,y`` in millimetres, or ``object``."""
    if words == "object":
        return None
    try:
        x_mm, y_mm = map(float, words.split(","))
    except ValueError as error:
        raise InputError(
            f"--at-mm is {words!r}; expected x,y in millimetres, such as 10,20, or object"
        ) from error
    return x_mm / 1e3, y_mm / 1e3


@command(app)
def render(
    *,
    file: Path = argument("FILE", "A mesh: STL, 3MF, PLY, OBJ or GLB.", read=Path),
    at: tuple[float, float] | None = text(
        (0.0, 0.0),
        name="--at-mm",
        metavar="X,Y|object",
        shown="0,0",
        read=_place_m,
        help="Centre of the gel, relative to the origin of the mesh; object: the mesh, wherever it is.",
    ),
    turn_deg: float = real(0.0, help="Rotation of the object about z."),
    unit: str | None = mesh.UNIT,
    picture: Annotated[dict[str, Any], OptionsOf(GenerateSpec)],
    press: Annotated[dict[str, Any], OptionsOf(ElasticPress)],
    out: Path = text(
        Path("touch.png"), name="--out", metavar="FILE", read=local_place, help="Image to write."
    ),
    sink: Sink,
) -> None:
    """Press the gel onto a mesh once and write the image.

    Example: tactile-sim render part.stl --at-mm 10,20 --turn-deg 17 --size 320x240 --out touch.png

    Example: tactile-sim render part.stl --at-mm object --out touch.png

    Example: tactile-sim render part.stl --gel elastic --force-n 5 --markers 7x9 --draw-markers
    """
    image_format = _ENDINGS.get(out.suffix.lower())
    if image_format is None:
        raise InputError(f"--out is {out.name!r}; expected a name that ends with {', '.join(_ENDINGS)}")
    spec = _spec_of(sink, picture, plan=TouchPlan(1, 1), press=_press_of(press))
    solid = mesh.read_mesh(file, unit=unit)
    for note in solid.notes:
        sink.info(f"note: {file}: {note}")
    seen = tactile_sim.preview_touch(solid, spec, at, math.radians(turn_deg))
    encoded = touch.encode_image(seen.picture, image_format, spec.quality)
    store.open_folder(str(out.parent.absolute())).write_bytes(out.name, encoded)
    document = {"file": str(out), "sensor_z_m": seen.sensor_z_m, "contact": seen.contact, **seen.forces}
    sink.document(document)
    sink.line(
        f"{out}: the sensor stops {1e3 * seen.sensor_z_m:.3f} mm above the plate; "
        f"{100 * seen.contact:.1f} % of the image is in contact with the object"
    )
    if seen.forces:
        x_n, y_n, z_n = seen.forces["force_n"]
        sink.line(
            f"the gel is pressed in by {1e3 * seen.forces['press_depth_m']:.3f} mm with {z_n:.2f} N; shear "
            f"{x_n:.2f} N along x, {y_n:.2f} N along y, torque {1e3 * seen.forces['torque_nm'][2]:.2f} N mm"
        )
    if not seen.contact:
        (low_x, low_y), (high_x, high_y) = (1e3 * seen.bounds_m).tolist()
        sink.info(
            f"the gel touched only the plate; the mesh is at x {low_x:.1f} to {high_x:.1f} mm, y {low_y:.1f} "
            f"to {high_y:.1f} mm; next: add --at-mm object, or a larger --size if it is thinner than a pixel"
        )


@command(app, asks_hub=True)
def pairs(
    *,
    objects: str = argument("DIGITS", "Digits or other meshes."),
    real: str = text(MISSING, metavar="TOUCHES", help="Real touches: name or folder."),
    split: str = text("train", metavar="NAME", help="Split of both data sets."),
    allow_incomplete: bool = INCOMPLETE,
    out: str = out_folder("pairs"),
    spec: PairsSpec,
    making: Making,
    sink: Sink,
) -> None:
    """Make the training set of a CycleGAN: unpaired depth images and real touches.

    Example: tactile-sim pairs digits --real real-single-320x240 --split train --out pairs
    """
    run.prepare_batch_process()
    opened = partial(Opening(allow_incomplete=allow_incomplete).open, sink)
    pairs = tactile_sim.PairsGenerator.of(objects, real, split, spec, opened)
    require = partial(pairs.refuse_sources, objects, out)
    generate_set(sink, "pressing and scaling", pairs, out, None, making, print_set, require)


@command(app)
def train(
    *,
    pairs: str = argument("PAIRS", "Folder that `tactile-sim pairs` made."),
    out: Path = local_out_folder("weights"),
    config: Path | None = text(
        metavar="FILE",
        read=local_place,
        help="TOML file with values of fields of `TrainConfig`, such as crop = 1.0; options override it.",
    ),
    options: Annotated[dict[str, Any], OptionsOf(TrainConfig)],
    device: str = choice("auto", ("auto", "cpu", "cuda"), help="Where to compute."),
    deterministic: bool = switch(False, help="Make every run give the same weights, on the CPU."),
    resume: bool = switch(False, help="Continue the training in the folder; an error if there is none."),
    compiled: bool = switch(False, name="--compile", help="Compile the generators first; for GPUs."),
    sink: Sink,
) -> None:
    """Train a CycleGAN: one generator of touches from depth, one of depth from touches.

    Example: tactile-sim train pairs --steps 7000 --config train.toml --out weights

    After an interruption, the same command continues from the last checkpoint.
    On several GPUs: torchrun --nproc-per-node 4 -m tactile_sim train pairs --out weights
    """
    # Torch takes seconds to import, and is an extra: the first import raises an error if it is missing.
    import tactile_sim.learned  # noqa: F401
    from tactile_sim.learned.training import train as train_both

    settings = TrainConfig.read(config, options)
    # `torchrun` starts this command once for each GPU, numbered by RANK: only the first one prints.
    if os.environ.get("RANK", "0") != "0":
        sink = Sink(quiet=True)
    with sink.progress("training", "steps") as update:
        done = train_both(
            pairs,
            str(out),
            settings,
            device=device,
            deterministic=deterministic,
            resume=resume,
            compiled=compiled,
            on_progress=update,
        )
    # JSON has no NaN; losses are NaN if no step was left.
    losses = dict.fromkeys(done.losses)
    losses |= {name: loss for name, loss in done.losses.items() if math.isfinite(loss)}
    sink.document({"folder": done.folder, "steps": done.steps, "taken": done.taken, "losses": losses})
    sink.line(f"{with_count(done.taken, 'steps')} taken, {done.steps:,} in all; the weights are in {out}")
    sink.line(f"next: tactile-sim evaluate {out} --pairs {pairs}")


@command(app)
def evaluate(
    *,
    weights: Path = argument("WEIGHTS", "Folder that `tactile-sim train` wrote.", read=local_place),
    pairs: str = text(MISSING, metavar="PAIRS", help="Pairs that the training did not use."),
    out: Path = local_out_folder("evaluation"),
    count: int = integer(2000, 1, help="Maximum number of images."),
    taxim: bool = switch(True, help="Compare with Taxim (extra sim)."),
    sensor_noise: str = text(
        "none",
        metavar=SENSOR_NOISE,
        help="Sensor noise that is added to all generated images, as for `generate --sensor-noise`.",
    ),
    seed: int = integer(0, help="Random seed."),
    device: str = choice("auto", ("auto", "cpu", "cuda"), help="Where to compute."),
    sink: Sink,
) -> None:
    """Measure trained weights on touches that the training did not use: a table and a sheet of images.

    Example: tactile-sim evaluate weights --pairs pairs-test --out evaluation
    """
    # Torch takes seconds to import, and is an extra: the first import raises an error if it is missing.
    import tactile_sim.learned
    from tactile_sim.learned.evaluation import BASELINES, evaluate as measure

    baselines = tuple(name for name in BASELINES if taxim or name != "taxim")
    noise = tactile_sim.SensorNoise.named(sensor_noise)
    with sink.progress("measuring", "methods") as update:
        found = measure(
            weights,
            pairs,
            baselines=baselines,
            count=count,
            noise=noise,
            seed=seed,
            device=device,
            on_progress=update,
        )
    found.write(out)
    sink.document(found.to_dict())
    sink.line(found.to_markdown())
    sink.line(f"table and pictures are in {out}")


command(app)(calibrate)
command(app)(check)
_own: dict[str, Any] = {"preview": preview_touches, "gallery": gallery_of_touches}
_own |= {"show": show_sensor, "upload": upload_sensor, "download": download_sensor}
add_shared(
    app,
    KIND,
    {**_own, "validate": None, "export": None},
    print_made=_print_made,
    checks=None,
    objects=Objects(),
)

main = partial(run_app, app)
