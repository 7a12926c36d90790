"""``tactile-sim``: press a simulated GelSight Mini onto solids, and make data sets of its touches."""

from __future__ import annotations

import math
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import typer

from cli.application import OptionsOf, command, new_app, run
from cli.folders import print_made
from cli.making import generate_set
from cli.options import Limit, Making, Out, local_place
from cli.output import Sink, bytes_text
from cli.preview_commands import preview_touches
from cli.shared_commands import add_shared
from cli.tactile_sim_learning import add_learning
from tactile_sim.kind import KIND
from tactile_sim.options import PictureOptions
from tactile_sim.spec import TouchPlan
from tactile_toolkit.checked_fields import real, text
from tactile_toolkit.errors import InputError

if TYPE_CHECKING:
    from tactile_toolkit.store.manifest import Manifest


app = new_app("tactile-sim", "Synthetic touches: press a simulated GelSight Mini onto any solid.")

_ENDINGS: dict[str, Literal["jpeg", "png"]] = {".png": "png", ".jpg": "jpeg", ".jpeg": "jpeg"}


@command(app)
def generate(
    *,
    objects: Annotated[
        str,
        typer.Argument(metavar="DIR|NAME", help="Digits, scenes or other meshes: folder, file or Hub id."),
    ],
    split: str = text("all", metavar="NAME|all", help="Split to make."),
    out: Out = "touches",
    plan: Annotated[dict[str, Any], OptionsOf(TouchPlan)],
    picture: PictureOptions,
    limit: Limit = None,
    making: Making,
    sink: Sink,
) -> None:
    """Make a data set of touches of all objects of a data set.

    Example: tactile-sim generate digits --split test --rounds 1 --touches 32 --out touches

    A stopped run continues when the same command is given again; finished shards are never made twice.
    """
    from tactile_sim.generation import forecast
    from tactile_sim.generation import generate as make
    from tactile_toolkit.run.limits import prepare_batch_process

    # "cell" is the default, and who gives a table means it; any other place with a table is refused.
    if "given" in plan and plan.get("place", "cell") == "cell":
        plan["place"] = "given"
    spec = picture.spec(TouchPlan(**plan), limit)
    splits = None if split == "all" else (split,)
    if not making.dry_run:
        prepare_batch_process()
    generate_set(
        sink,
        KIND,
        making,
        out,
        splits,
        what="rendering",
        forecast=partial(forecast, objects, spec, out, splits),
        make=partial(make, objects, spec, out, splits),
        print_made=_print_made,
    )


def _print_made(sink: Sink, manifest: Manifest, out: str, elapsed_s: float | None) -> None:
    rows = []
    for split, held in manifest.split_table().items():
        # Shards carry their counts, so that no row is read for this table.
        parts = [record.statistics or {} for record in manifest.shards_of(split)]
        touches, contact = (sum(part.get(name, 0) for part in parts) for name in ("touches", "on_object"))
        share = f"{100 * contact / touches:.1f} %" if touches else "-"
        rows.append((split, held["rows"], touches, share, held["skipped"], bytes_text(held["bytes"])))
    header = ("split", "rounds", "touches", "on the object", "objects left out", "Parquet")
    print_made(sink, KIND, manifest, out, manifest.split_table(), elapsed_s, (header, rows))


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


def _mm_of_m(words: str) -> str:
    """Convert what ``--at`` took to what ``--at-mm`` takes."""
    try:
        return (
            words if words == "object" else ",".join(f"{1e3 * float(each):.12g}" for each in words.split(","))
        )
    except ValueError:
        return words


def _deg_of_rad(words: str) -> str:
    try:
        return f"{math.degrees(float(words)):.15g}"
    except ValueError:
        return words


@command(app, former={"--at": ("--at-mm", _mm_of_m), "--turn": ("--turn-deg", _deg_of_rad)})
def render(
    *,
    mesh: Annotated[
        Path, typer.Argument(metavar="FILE", help="A mesh: STL/3MF/PLY/OBJ in millimetres, GLB in metres.")
    ],
    at: tuple[float, float] | None = text(
        (0.0, 0.0),
        name="--at-mm",
        metavar="X,Y|object",
        shown="0,0",
        read=_place_m,
        help="Where the gel goes, from the origin of the mesh; or onto the mesh wherever it is.",
    ),
    turn_deg: float = real(0.0, help="Turn of the object about z."),
    picture: PictureOptions,
    out: Path = text(
        Path("touch.png"),
        name="--out",
        shown="touch.png",
        metavar="FILE",
        read=local_place,
        help="Picture to write.",
    ),
    sink: Sink,
) -> None:
    """Press the gel onto a mesh once and write the picture.

    Example: tactile-sim render part.stl --at-mm 10,20 --turn-deg 17 --size 320x240 --out touch.png

    Example: tactile-sim render part.stl --at-mm object --out touch.png
    """
    from tactile_sim.looking import look
    from tactile_toolkit.mesh.files import read_mesh
    from tactile_toolkit.store.folder import DataFolder
    from tactile_toolkit.touch.jpeg import encode_image

    image_format = _ENDINGS.get(out.suffix.lower())
    if image_format is None:
        raise InputError(f"--out is {out.name!r}; expected a picture that ends with {', '.join(_ENDINGS)}")
    seen = look(read_mesh(mesh), picture.spec(), at, math.radians(turn_deg))
    encoded = encode_image(seen.picture, image_format, picture.quality)
    DataFolder(str(out.parent.absolute())).write_bytes(out.name, encoded)
    sink.document({"file": str(out), "sensor_z_m": seen.sensor_z_m, "contact": seen.contact})
    sink.line(
        f"{out}: the sensor stops {1e3 * seen.sensor_z_m:.3f} mm above the plate; "
        f"{100 * seen.contact:.1f} % of the picture is in contact with the object"
    )
    if not seen.contact:
        (low_x, low_y), (high_x, high_y) = (1e3 * seen.bounds_m).tolist()
        sink.info(
            f"the gel met the plate only; the mesh is at x {low_x:.1f} to {high_x:.1f} mm, y {low_y:.1f} to "
            f"{high_y:.1f} mm; next: --at-mm object, or a larger --size where it is thinner than a pixel"
        )


add_learning(app)
add_shared(app, KIND, preview_touches, print_folder=_print_made)


def main() -> None:
    """Run the command line."""
    run(app)
