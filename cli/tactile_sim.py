"""``tactile-sim``: press a simulated GelSight Mini onto solids, and make data sets of its touches."""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import typer

from cli.application import command, new_app, run
from cli.folders import add_verify, print_made, print_spec
from cli.gallery_commands import add_touch_gallery
from cli.hub_upload import add_hub_commands
from cli.making import make_with_progress, print_forecast
from cli.options import Folder, Json, Limit, Making, Out, Seed, local_place, parse_size
from cli.output import Sink, bytes_text
from cli.preview_commands import preview_touches
from cli.tactile_sim_learning import add_learning
from tactile_sim.kind import KIND

if TYPE_CHECKING:
    from tactile_sim.generation import GenerateSpec
    from tactile_sim.plan import TouchPlan
    from tactile_toolkit.store.manifest import Manifest

__all__ = ["app", "main"]

app = new_app("tactile-sim", "Synthetic touches: press a simulated GelSight Mini onto any solid.")

OpticsName = Literal["depth", "taxim", "cyclegan"]


@dataclass(frozen=True, slots=True)
class PlanOptions:
    """Where the gel goes."""

    rounds: Annotated[int, typer.Option(min=1, metavar="N", help="Rounds of each object.")] = 16
    touches: Annotated[int, typer.Option(min=1, metavar="N", help="Touches of a round.")] = 32
    place: Annotated[
        Literal["cell", "grid", "object", "given"],
        typer.Option(
            help="Where the gel goes: uniform in the cell, on a grid, or on the object only; or given by "
            "--touches-from."
        ),
    ] = "cell"
    touches_from: Annotated[
        Path | None,
        typer.Option(
            metavar="FILE",
            help="Table of touches, CSV, Parquet or npz: x_m, y_m; object_id, round; object_x_m, object_y_m, "
            "object_turn_rad.",
            parser=local_place,
        ),
    ] = None
    turn: Annotated[
        Literal["digits", "any", "none"],
        typer.Option(help="Turn of the object: up to 22.5 degrees, any, or none."),
    ] = "digits"
    shift: Annotated[
        bool, typer.Option(help="Move the object a little after each touch, as the environments do.")
    ] = True
    seed: Seed = 0

    def plan(self) -> TouchPlan:
        """Return the plan of touches."""
        from tactile_sim.given import GivenTouches
        from tactile_sim.plan import TURNS, TouchPlan

        given = None if self.touches_from is None else GivenTouches.read(self.touches_from)
        # "cell" is the default, and who gives a table means it; any other place with a table is refused.
        return TouchPlan(
            self.rounds,
            self.touches,
            "given" if given is not None and self.place == "cell" else self.place,
            given,
            turn_rad=TURNS[self.turn],
            shift=self.shift,
            seed=self.seed,
        )


@dataclass(frozen=True, slots=True)
class PictureOptions:
    """What a touch looks like."""

    size: Annotated[str, typer.Option(metavar="WxH", help="Size of the pictures, pixels.")] = "64x64"
    optics: Annotated[OpticsName, typer.Option(help="How depth becomes a picture.")] = "taxim"
    like: Annotated[
        Literal["environment", "published"],
        typer.Option(
            help="environment: rendered in this size, with the window that the environments show; published: "
            "rendered as 320x240 of the whole sensor and scaled."
        ),
    ] = "environment"
    image_format: Annotated[
        Literal["jpeg", "png"], typer.Option("--format", help="Format of the pictures.")
    ] = "jpeg"
    quality: Annotated[int, typer.Option(min=1, max=100, help="Quality of JPEGs.")] = 95
    weights: Annotated[
        Path | None,
        typer.Option(
            metavar="FILE",
            help="Weights for cyclegan; those of tactile-mnist by default.",
            parser=local_place,
        ),
    ] = None

    surface: Annotated[
        Literal["smooth", "printed"],
        typer.Option(help="Solids as they are modelled, or with the layers that a printer lays."),
    ] = "smooth"
    layer_mm: Annotated[
        float,
        typer.Option(min=0.02, max=2.0, metavar="MM", help="Height of the layers with --surface printed."),
    ] = 0.2
    noise: Annotated[
        str,
        typer.Option(
            metavar="none|calibrated|FILE",
            help="Noise of a real sensor on the pictures: none, as calibrated in tactile-mnist, or as in "
            "a JSON file.",
        ),
    ] = "none"

    def spec(self, plan: TouchPlan | None = None, limit: int | None = None) -> GenerateSpec:
        """Return the specification of touches."""
        from tactile_sim.generation import GenerateSpec, require_pictures
        from tactile_sim.noise import SensorNoise
        from tactile_sim.plan import TouchPlan
        from tactile_toolkit.errors import InputError

        if self.layer_mm != PictureOptions().layer_mm and self.surface != "printed":
            message = "--layer-mm is about printed solids; next: add --surface printed"
            raise InputError(message)
        if self.noise != "none":
            require_pictures(self.optics)  # before a package is asked for that would not help
        return GenerateSpec(
            parse_size(self.size),
            self.optics,
            self.like,
            TouchPlan() if plan is None else plan,
            self.image_format,
            self.quality,
            None if self.weights is None else str(self.weights),
            limit,
            self.layer_mm / 1000 if self.surface == "printed" else 0.0,
            SensorNoise.named(self.noise),
        )


@command(app)
def generate(
    *,
    objects: Annotated[
        str,
        typer.Argument(metavar="DIR|NAME", help="Digits, scenes or other meshes: folder, file or Hub id."),
    ],
    split: Annotated[str, typer.Option(metavar="NAME|all", help="Split to make.")] = "all",
    out: Out = "touches",
    plan: PlanOptions,
    picture: PictureOptions,
    limit: Limit = None,
    making: Making,
    sink: Sink,
) -> None:
    """Make a data set of touches of all objects of a data set.

    Example: tactile-sim generate digits --split test --rounds 1 --touches 32 --out touches

    A run that was stopped goes on when the same command is given again; finished shards are never made twice.
    """
    from tactile_sim.generation import forecast
    from tactile_sim.generation import generate as make
    from tactile_toolkit.run.limits import prepare_batch_process

    spec = picture.spec(plan.plan(), limit)
    splits = None if split == "all" else (split,)
    if making.dry_run:
        view = forecast(objects, spec, out, splits, making.chosen_runner(), overwrite=making.overwrite)
        print_forecast(sink, KIND, view, out, making)
        return
    prepare_batch_process()
    made = make_with_progress(
        sink, "rendering", KIND.nouns, partial(make, objects, spec, out, splits), making, out
    )
    if made is None:
        return
    _print_made(sink, made.manifest, out, made.elapsed_s)
    sink.line(f"{made.text}; the data set is in {out}")
    first = next(iter(made.manifest.split_table()))
    sink.line(f"next in Python: {KIND.package}.load({out!r}, split={first!r})")


@command(app)
def info(folder: Folder, as_json: Json = False) -> None:
    """Show what a data set folder holds and how it was made."""
    from tactile_toolkit.catalog.kinds import require_manifest
    from tactile_toolkit.store.folder import DataFolder
    from tactile_toolkit.store.job import manifest_so_far

    sink, place = Sink(as_json), DataFolder(folder)
    # Rows alone would not tell synthetic touches from recorded ones, so these folders have a manifest.
    manifest = manifest_so_far(place) or require_manifest(KIND, place)
    KIND.refuse_other(manifest, folder)
    _print_made(sink, manifest, folder)
    print_spec(sink, manifest, "spec")


def _print_made(sink: Sink, manifest: Manifest, out: str, elapsed_s: float | None = None) -> None:
    rows = []
    for split, held in manifest.split_table().items():
        # Shards carry their counts, so that no row is read for this table.
        parts = [record.statistics or {} for record in manifest.shards_of(split)]
        touches, contact = (sum(part.get(name, 0) for part in parts) for name in ("touches", "on_object"))
        share = f"{100 * contact / touches:.1f} %" if touches else "-"
        rows.append((split, held["rows"], touches, share, held["skipped"], bytes_text(held["bytes"])))
    header = ("split", "rounds", "touches", "on the object", "objects left out", "Parquet")
    print_made(sink, KIND, manifest, out, manifest.split_table(), elapsed_s, (header, rows))


def _place(text: str) -> tuple[float, float] | None:
    if text == "object":
        return None
    parts = text.split(",")
    try:
        x, y = map(float, parts)
    except ValueError as error:
        message = f"{text!r} is not a position; expected x,y in metres, such as 0.01,0.02, or object"
        raise typer.BadParameter(message) from error
    return x, y


@command(app)
def render(
    *,
    mesh: Annotated[
        Path, typer.Argument(metavar="FILE", help="A mesh: STL/3MF/PLY/OBJ in millimetres, GLB in metres.")
    ],
    at: Annotated[
        str,
        typer.Option(
            metavar="X,Y|object",
            help="Where the gel goes: metres from the origin of the mesh, or onto the mesh wherever it is.",
        ),
    ] = "0,0",
    turn: Annotated[float, typer.Option(metavar="RAD", help="Turn of the object about z, radians.")] = 0.0,
    picture: PictureOptions,
    out: Annotated[
        Path, typer.Option("--out", "-o", metavar="FILE", help="Picture to write.", parser=local_place)
    ] = Path("touch.png"),
    sink: Sink,
) -> None:
    """Press the gel onto a mesh once and write the picture.

    Example: tactile-sim render part.stl --at 0.01,0.02 --turn 0.3 --size 320x240 --out touch.png

    Example: tactile-sim render part.stl --at object --out touch.png
    """
    from tactile_sim.looking import look
    from tactile_toolkit.errors import InputError
    from tactile_toolkit.mesh.files import read_mesh
    from tactile_toolkit.store.folder import DataFolder
    from tactile_toolkit.touch.jpeg import encode_image

    kinds: dict[str, Literal["jpeg", "png"]] = {".png": "png", ".jpg": "jpeg", ".jpeg": "jpeg"}
    if out.suffix.lower() not in kinds:
        message = f"--out is {out.name!r}; expected a picture that ends with {', '.join(kinds)}"
        raise InputError(message)
    spec = picture.spec()
    seen = look(read_mesh(mesh), spec, _place(at), turn)
    encoded = encode_image(seen.picture, kinds[out.suffix.lower()], picture.quality)
    DataFolder(str(out.parent.absolute())).write_bytes(out.name, encoded)
    sink.document({"file": str(out), "sensor_z_m": seen.sensor_z_m, "contact": seen.contact})
    sink.line(
        f"{out}: the sensor stops {1e3 * seen.sensor_z_m:.3f} mm above the plate; "
        f"{100 * seen.contact:.1f} % of the picture is in contact with the object"
    )
    if not seen.contact:
        (low_x, low_y), (high_x, high_y) = (1e3 * seen.bounds_m).tolist()
        sink.talk(
            f"the gel met the plate only; the mesh is at x {low_x:.1f} to {high_x:.1f} mm, y {low_y:.1f} to "
            f"{high_y:.1f} mm; next: --at object, or a larger --size where it is thinner than a pixel"
        )


add_learning(app)
add_verify(app, KIND, "a data set folder")
command(app, "preview")(preview_touches)
add_hub_commands(app, KIND)
add_touch_gallery(app)


def main() -> None:
    """Run the command line."""
    run(app)
