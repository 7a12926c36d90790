"""``tactile-sim``: press a simulated GelSight Mini onto solids, and make data sets of its touches."""

from __future__ import annotations

import math
import os
from collections.abc import Callable
from dataclasses import MISSING, asdict
from functools import partial
from pathlib import Path
from typing import Annotated, Literal

import typer

import realtouch
import tactile_sim
from cli import contents, options, output, runs
from cli.application import EXIT_FAILED, command, new_app, run as run_app
from cli.options import SourceOptions, argument, local_out_folder, parse_local_path
from cli.output import Sink
from cli.realtouch import convert
from realtouch.kind import KIND
from tactile_sim import ElasticPress, PairSetSpec, TouchPlan, TouchSetSpec, TrainConfig, TrainRun
from tactile_sim.press import sensors
from tactile_sim.press.sensors import GELSIGHT_MINI, SensorModel
from tactile_sim.sets.set_options import default_optics
from tactile_toolkit import catalog, checked_fields, kind, mesh, run, store, touch
from tactile_toolkit.checked_fields import text
from tactile_toolkit.errors import InputError
from tactile_toolkit.wording import with_count

_ENDINGS: dict[str, Literal["jpeg", "png"]] = {".png": "png", ".jpg": "jpeg", ".jpeg": "jpeg"}
# Imported when it is called: it imports torch, which takes seconds and is an extra.
_train = kind.lazy("tactile_sim.learned.training:train")
_lift_attempts = kind.lazy("tactile_sim.sets.grasps:GraspGenerator.of")  # imports MuJoCo, an extra
_sensor_output = kind.lazy("tactile_sim.twin.twin_files:open_sensor_output")

app = new_app("tactile-sim", "Synthetic touches: press a simulated GelSight Mini onto any solid.")


@command(app)
def generate(
    *,
    objects: str = options.argument(
        "FILE|DIR|NAME", "Mesh file, folder of mesh files, or data set of meshes."
    ),
    source_options: options.SourceOptions,
    chosen: catalog.RowFilter,
    unit: str | None = mesh.UNIT,
    out: str = options.out_folder("touches"),
    plan: Annotated[options.UserOptions, options.OptionsOf(TouchPlan)],
    picture: Annotated[options.UserOptions, options.OptionsOf(TouchSetSpec)],
    press: Annotated[options.UserOptions, options.OptionsOf(ElasticPress)],
    run_options: options.GenerateOptions,
    sink: output.Sink,
) -> None:
    """Press the gel onto the objects of a data set, or onto your own, and write a data set of touches.

    Example: tactile-sim generate digits --split test --rounds 1 --touches 32 --out touches

    Example: tactile-sim generate part.stl --positions object --sensor digit --optics depth --out touches

    Example: tactile-sim generate digits --gel elastic --force-n 1:10 --slide-mm 0:0.5 --markers 7x9

    In a folder of mesh files, each sub-folder is a class, or each file if there are no sub-folders. The
    sub-folders train and test are splits.

    After an interruption, the same command continues; finished shards are kept.
    """
    # A table of positions implies `given` in place of the default `cell`; other values are refused.
    if "touch_table" in plan and plan.get("positions", "cell") == "cell":
        plan["positions"] = "given"
    filters = chosen.given()
    split = filters.pop("split", None)
    spec = spec_of(sink, picture, plan=TouchPlan(**plan), press=press_of(press), **filters)
    make = partial(tactile_sim.TouchGenerator.of, objects, spec, unit)
    _generate(sink, make, objects, source_options, out, split, run_options)


def _generate(
    sink: output.Sink,
    make: Callable[..., tactile_sim.TouchGenerator],
    objects: str,
    source_options: SourceOptions,
    out: str,
    split: str | None,
    run_options: options.GenerateOptions,
) -> None:
    """Make a data set of touches; ``make`` takes what opens a data set of objects."""
    if not run_options.dry_run:
        run.prepare_batch_process()
    touches = make(opened=partial(source_options.open_source, sink))
    if touches.has_own_objects:
        options.refuse(asdict(source_options), "mesh files")
    require = partial(touches.refuse_sources, objects, out)
    runs.generate_set(sink, "rendering", touches, out, split and (split,), run_options, require)


@command(app)
def grasp(
    *,
    objects: str = options.argument("FILE|DIR|NAME", "Flat solids: digits, or your own meshes."),
    source_options: options.SourceOptions,
    chosen: catalog.RowFilter,
    unit: str | None = mesh.UNIT,
    out: str = options.out_folder("grasps"),
    picture: Annotated[options.UserOptions, options.OptionsOf(tactile_sim.GraspSpec)],
    run_options: options.GenerateOptions,
    sink: output.Sink,
) -> None:
    """Lift objects between two gels, and write images and forces, labelled slip or hold.

    A row is an attempt: what both gels show before, while and after the load grows. Needs the extra
    `mujoco`.

    Example: tactile-sim grasp digits --split test --attempts 4 --out grasps

    After an interruption, the same command continues; finished shards are kept.
    """
    filters = chosen.given()
    split = filters.pop("split", None)
    spec = spec_of(sink, picture, tactile_sim.GraspSpec, **filters)
    make = partial(_lift_attempts, objects, spec, unit)
    _generate(sink, make, objects, source_options, out, split, run_options)


def spec_of(
    sink: output.Sink,
    picture: options.UserOptions,
    spec_type: type[TouchSetSpec] = TouchSetSpec,
    **others: object,
) -> TouchSetSpec:
    """Return the specification of the options that were given."""
    known = "optics" in picture
    optics = default_optics()
    sensor = picture.get("sensor", sensors.GELSIGHT_MINI)
    if sensor != sensors.GELSIGHT_MINI:
        known = True
        optics = sensor.optics_name
    spec = spec_type(**{"optics": optics, **picture, **others})
    if not known and spec.optics == "depth":
        sink.info("note: images are depth images; --optics taxim needs the extra `sim`")
    return spec


def press_of(user_options: options.UserOptions) -> tactile_sim.ElasticPress | None:
    """Return the press of the options that were given; None without an elastic gel."""
    if user_options.get("gel") is None:
        return None
    return tactile_sim.ElasticPress(**user_options)


def _position_m(words: str) -> tuple[float, float] | None:
    """Read ``x,y`` in millimetres, or ``object``."""
    if words == "object":
        return None
    try:
        x_mm, y_mm = map(float, words.split(","))
    except ValueError as error:
        raise InputError(
            f"is {words!r}; expected x,y in millimetres, such as 10,20, or object", field="at_mm"
        ) from error
    return x_mm / 1e3, y_mm / 1e3


@command(app)
def render(
    *,
    file: Path = options.argument("FILE", "A mesh: STL, 3MF, PLY, OBJ or GLB.", read=Path),
    at_mm: tuple[float, float] | None = checked_fields.text(
        (0.0, 0.0),
        metavar="X,Y|object",
        shown="0,0",
        read=_position_m,
        help="Centre of the gel, relative to the origin of the mesh; object: a place on the mesh.",
    ),
    turn_deg: float = checked_fields.real(0.0, -36_000, 36_000, help="Rotation of the object about z."),
    unit: str | None = mesh.UNIT,
    picture: Annotated[options.UserOptions, options.OptionsOf(TouchSetSpec)],
    press: Annotated[options.UserOptions, options.OptionsOf(tactile_sim.ElasticPress)],
    out: Path = checked_fields.text(
        Path("touch.png"),
        name="--out -o",
        metavar="FILE",
        read=options.parse_local_path,
        help="Image to write.",
    ),
    overwrite: bool = options.OVERWRITE,
    sink: output.Sink,
) -> None:
    """Press the gel onto a mesh once and write the image.

    Example: tactile-sim render part.stl --at-mm 10,20 --turn-deg 17 --size 320x240 --out touch.png

    Example: tactile-sim render part.stl --at-mm object --out touch.png

    Example: tactile-sim render part.stl --gel elastic --force-n 5 --markers 7x9 --draw-markers
    """
    image_format = _ENDINGS.get(out.suffix.lower())
    if image_format not in (None, picture.get("image_format", image_format)):
        raise InputError("differs from the ending of --out", next="leave it out", field="image_format")
    if image_format is None:
        raise InputError(
            f"is {out.name!r}; expected a name that ends with {', '.join(_ENDINGS)}", field="out"
        )
    written = store.open_output(out, overwrite=overwrite)
    spec = spec_of(sink, picture, plan=tactile_sim.TouchPlan(1, 1), press=press_of(press))
    solid = mesh.read_mesh(file, unit=unit)
    for note in solid.notes:
        sink.info(f"note: {file}: {note}")
    preview = tactile_sim.preview_touch(solid, spec, at_mm, math.radians(turn_deg))
    written.write({out.name: touch.encode_image(preview.picture, image_format, spec.quality)})
    _print_touch(sink, out, preview)


def _print_touch(sink: output.Sink, out: Path, preview: tactile_sim.TouchPreview) -> None:
    """Print what a rendered touch shows, and what the gel feels."""
    document = {
        "file": str(out),
        "sensor_z_m": preview.sensor_z_m,
        "contact": preview.contact,
        **preview.forces,
    }
    sink.document(document)
    sink.line(
        f"{out}: the sensor stops {1e3 * preview.sensor_z_m:.3f} mm above the plate; "
        f"{100 * preview.contact:.1f} % of the image is in contact with the object"
    )
    if preview.forces:
        x_n, y_n, z_n = preview.forces["force_n"]
        sink.line(
            f"the gel is pressed in by {1e3 * preview.forces['press_depth_m']:.3f} mm with {z_n:.2f} N; "
            f"shear {x_n:.2f} N along x, {y_n:.2f} N along y, "
            f"torque {1e3 * preview.forces['torque_n_m'][2]:.2f} N mm"
        )
    if not preview.contact:
        (low_x, low_y), (high_x, high_y) = (1e3 * preview.bounds_m).tolist()
        sink.info(
            f"the gel touched only the plate; the mesh is at x {low_x:.1f} to {high_x:.1f} mm, y {low_y:.1f} "
            f"to {high_y:.1f} mm; next: add --at-mm object, or a larger --size if it is thinner than a pixel"
        )


@command(app)
def calibrate(
    *,
    source: str = argument("SOURCE", "Touches of printed solids: a data set, or a folder of images."),
    source_options: SourceOptions,
    solids: str = text(
        MISSING, metavar="SET", help="The printed solids: mesh files, or a data set of meshes."
    ),
    table: Path | None = text(
        metavar="FILE",
        read=parse_local_path,
        help="Table of the images, CSV or TSV: file, object; x_m, y_m, z_m of the sensor; object_x_m, "
        "object_y_m, object_turn_rad.",
    ),
    background: list[str] | None = text(
        metavar="IMAGE",
        several=True,
        help="Image of the gel without contact, or a folder of them; may be repeated.",
    ),
    unit: str | None = mesh.UNIT,
    sensor: str = text(
        GELSIGHT_MINI.name,
        name="--start",
        metavar="NAME|FILE",
        help="First guess of the geometry: a sensor or JSON file.",
    ),
    out: Path = local_out_folder("my-sensor"),
    overwrite: bool = options.OVERWRITE,
    sink: Sink,
) -> None:
    """Make the twin of a sensor, a model that renders its images and reads depth from them.

    Problems of the recordings are listed first. Poses may be off by a millimetre and some degrees.
    Without any, touches are found by matching; those that look the same in several places are left out.

    Example: tactile-sim calibrate recordings --solids plate --out my-sensor
    """
    _sensor_output(out, overwrite=overwrite)
    start = SensorModel.named(sensor)
    recordings = tactile_sim.read_recordings(
        source,
        solids,
        table=table,
        backgrounds=background or (),
        unit=unit,
        opened=partial(source_options.open_source, sink),
    )
    mistakes = tactile_sim.find_mistakes(recordings, start)
    for mistake in mistakes:
        sink.warn(f"{mistake.kind}: {mistake}")
    with sink.progress("calibrating", "steps") as update:
        model = tactile_sim.calibrate(recordings, name=out.name, start=start, on_progress=update)
    model.save(out, overwrite=overwrite)
    for mistake in model.report["mistakes"][len(mistakes) :]:  # that only a fit finds
        sink.warn(f"{mistake['kind']}: {mistake['detail']}")
    contents.print_sensor(sink, model)
    sink.line(f"{with_count(len(recordings), 'touches')} of {source}; the sensor is in {out}")
    sink.line(f"next: tactile-sim check {out} {source}")


@command(app, asks_hub=True)
def pairs(
    *,
    objects: str = options.argument("DIGITS", "Digits or other meshes."),
    real: str = checked_fields.text(MISSING, metavar="TOUCHES", help="Real touches: name or folder."),
    split: str = checked_fields.text("train", metavar="NAME", help="Split of both data sets."),
    allow_incomplete: bool = options.INCOMPLETE,
    out: str = options.out_folder("pairs"),
    spec: PairSetSpec,
    run_options: options.GenerateOptions,
    sink: output.Sink,
) -> None:
    """Make the training set of a CycleGAN: unpaired depth images and real touches.

    Example: tactile-sim pairs digits --real real-single-320x240 --split train --out pairs
    """
    run.prepare_batch_process()
    opened = partial(options.SourceOptions(allow_incomplete=allow_incomplete).open_source, sink)
    pairs = tactile_sim.PairGenerator.of(objects, real, split, spec, opened)
    require = partial(pairs.refuse_sources, objects, out)
    runs.generate_set(sink, "pressing and scaling", pairs, out, None, run_options, require)


@command(app)
def train(
    *,
    pairs: str = options.argument("PAIRS", "Folder that `tactile-sim pairs` made."),
    out: Path = options.local_out_folder("weights"),
    config: Path | None = checked_fields.text(
        metavar="FILE",
        read=options.parse_local_path,
        help="TOML file with fields of `TrainConfig`, such as crop = 1.0; options override it.",
    ),
    training: Annotated[options.UserOptions, options.OptionsOf(TrainConfig)],
    train_run: TrainRun,
    sink: output.Sink,
) -> None:
    """Train a CycleGAN: a generator from depth to touches, and one from touches to depth.

    Example: tactile-sim train pairs --steps 7000 --config train.toml --out weights

    After an interruption, the same command continues from the last checkpoint.
    On several GPUs: torchrun --nproc-per-node 4 -m tactile_sim train pairs --out weights
    """
    settings = TrainConfig.read(config, training)
    # `torchrun` starts this command once for each GPU, numbered by RANK: only the first one prints.
    if os.environ.get("RANK", "0") != "0":
        sink = output.Sink(quiet=True)
        run.prepare_command(quiet=True)
    with sink.progress("training", "steps", keeps_parts=True) as update:
        done = _train(pairs, str(out), settings, train_run, on_progress=update)
    # JSON has no NaN; losses are NaN if no step was left.
    losses = dict.fromkeys(done.losses)
    losses |= {name: loss for name, loss in done.losses.items() if math.isfinite(loss)}
    sink.document({"folder": done.folder, "steps": done.steps, "taken": done.taken, "losses": losses})
    sink.line(f"{with_count(done.taken, 'steps')} taken, {done.steps:,} in all; the weights are in {out}")


@command(app)
def check(
    *,
    sensor: Path = argument("SENSOR", "Folder that `tactile-sim calibrate` wrote.", read=parse_local_path),
    source: str = argument("SOURCE", "Recent touches: a data set, or a folder of images."),
    sink: Sink,
) -> None:
    """Check whether a sensor has changed since it was calibrated.

    The touched objects do not matter; the places on the gel should differ. Exit code 1 if a figure is beyond
    its limit.

    Example: tactile-sim check my-sensor recordings-of-today
    """
    model = SensorModel.load(sensor)
    health = tactile_sim.check_sensor(model, tactile_sim.images_of(source))
    sink.document({"sensor": model.name, **health.to_dict()})
    rows = [
        (
            figure.name,
            f"{figure.value:.3g}",
            f"{figure.limit:g}",
            "ok" if figure.ok else "BEYOND",
            figure.meaning,
        )
        for figure in health.figures
    ]
    sink.table(("figure", "found", "limit", "", "what it is"), rows)
    if health.recording:
        sink.info(f"note: {health.recording}")
    state = health.cause or "the sensor is as it was calibrated"
    sink.line(f"{with_count(health.images, 'images')} compared with {sensor}; {state}")
    if not health.ok:
        raise typer.Exit(EXIT_FAILED)


@command(app)
def depth(
    *,
    name: str = options.NAME,
    source_options: SourceOptions,
    sensor: str = text(MISSING, metavar="SENSOR", help="Folder that `tactile-sim calibrate` wrote."),
    fast: bool = checked_fields.switch(False, help="Read at half the resolution, in half of the time."),
    out: str = options.out_folder(),
    split: str | None = catalog.row_option("split"),
    limit: int | None = catalog.row_option("limit"),
    run_options: options.RunOptions,
    sink: Sink,
) -> None:
    """Write touches with indentation depth in metres, as the twin of the sensor reads it from their images.

    Each pixel has an expected error.

    Example: tactile-sim depth recordings --sensor my-sensor --out depths
    """
    place = source_options.open_source(sink, name).require(KIND, "tactile-sim depth")
    make = partial(realtouch.add_depth, place, out, sensor=sensor, fast=fast, split=split, limit=limit)
    convert(sink, place, split, make, run_options, out)


main = partial(run_app, app)
