"""``tactile-sim``: press a simulated GelSight Mini onto solids, and make data sets of its touches."""

from __future__ import annotations

from functools import partial
from typing import Annotated

import tactile_sim
from cli import (
    calibration,
    checks,
    declared_options,
    galleries,
    learned_sensors,
    options,
    output,
    previews,
    runs,
    sensor_twins,
    shared,
    touch_rendering,
)
from cli.application import command, new_app, run as run_app
from tactile_sim import ElasticPress, GenerateSpec, TouchPlan
from tactile_sim.kind import KIND
from tactile_toolkit import catalog, mesh, run, store, wording
from tactile_toolkit.errors import InputError
from tactile_toolkit.kind import DatasetKind

app = new_app("tactile-sim", "Synthetic touches: press a simulated GelSight Mini onto any solid.")


@command(app)
def generate(
    *,
    objects: str = options.argument(
        "FILE|DIR|NAME", "Mesh file, folder of mesh files, or data set of meshes."
    ),
    opening: options.Opening,
    chosen: catalog.RowFilter,
    unit: str | None = mesh.UNIT,
    out: str = options.out_folder("touches"),
    plan: Annotated[declared_options.Given, declared_options.OptionsOf(TouchPlan)],
    picture: Annotated[declared_options.Given, declared_options.OptionsOf(GenerateSpec)],
    press: Annotated[declared_options.Given, declared_options.OptionsOf(ElasticPress)],
    making: options.Making,
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
    if "given" in plan and plan.get("positions", "cell") == "cell":
        plan["positions"] = "given"
    given = chosen.given()
    split = given.pop("split")
    splits = split and (split,)
    spec = touch_rendering.spec_of(
        sink, picture, plan=TouchPlan(**plan), press=touch_rendering.press_of(press), **given
    )
    if not making.dry_run:
        run.prepare_batch_process()
    touches = tactile_sim.TouchGenerator.of(objects, spec, unit, partial(opening.open, sink))
    if touches.has_own_objects and opening != options.Opening():
        raise InputError(
            f"--revision, --config-name and --allow-incomplete are for data sets, and {objects!r} is "
            "of mesh files",
            next="leave them out",
        )
    require = partial(touches.refuse_sources, objects, out)
    runs.generate_set(sink, "rendering", touches, out, splits, making, _print_made, require)


def _print_made(
    sink: output.Sink, kind: DatasetKind, manifest: store.Manifest, out: str, elapsed_s: float | None
) -> None:
    rows = []
    for split, held in manifest.split_table().items():
        # Shard records hold these counts, so no row is read.
        parts = [record.statistics or {} for record in manifest.shards_of(split)]
        touches, contact = (sum(part.get(name, 0) for part in parts) for name in ("touches", "on_object"))
        share = "-"
        if touches:
            share = f"{100 * contact / touches:.1f} %"
        rows.append((split, held["rows"], touches, share, held["skipped"], wording.bytes_text(held["bytes"])))
    header = ("split", "rounds", "touches", "on the object", "objects left out", "Parquet")
    runs.print_set(sink, kind, manifest, out, elapsed_s, header, rows)


command(app)(touch_rendering.render)
command(app, asks_hub=True)(learned_sensors.pairs)
for _command in (learned_sensors.train, calibration.calibrate, sensor_twins.check):
    command(app)(_command)
shared.add_shared(
    app,
    KIND,
    {
        "preview": previews.preview_touches,
        "gallery": galleries.gallery_of_touches,
        "show": sensor_twins.show_sensor,
        "upload": sensor_twins.upload_sensor,
        "download": sensor_twins.download_sensor,
        "validate": None,
        "export": None,
    },
    print_made=_print_made,
    checks=None,
    objects=checks.Objects(),
)

main = partial(run_app, app)
