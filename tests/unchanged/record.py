"""Record of everything that users and stored data rely on: bytes, pixels, environments, names.

``python -m tests.unchanged.record`` writes the record and the output of notebooks again after an intended
change; a review shows the differences.
"""

from __future__ import annotations

import hashlib
import inspect
import io
import json
import tempfile
from collections.abc import Iterator
from contextlib import suppress
from dataclasses import MISSING, fields, is_dataclass
from importlib import import_module
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image

import mnist3d
import mnist3d.digit_previews
import realtouch
import realtouch.touch_previews
import starstruck_gen
import starstruck_gen.scene_card
from mnist3d.digit_options import DigitPreviewSpec
from mnist3d.sources.synthetic import SyntheticSource
from realtouch.touch_options import TouchPreviewSpec
from tactile_sim import make_pairs
from tactile_toolkit.catalog import PreviewSpec
from tactile_toolkit.errors import MissingExtraError
from tactile_toolkit.printing.plate_layouts import arrange, draw_map
from tactile_toolkit.printing.print_options import PlateSpec
from tests.env_assets.factories import write_assets
from tests.notebooks.running import main as record_notebooks
from tests.realtouch.factories import make_round, seq_rows, single_rows, write_set
from tests.tactile_sim import made_up_sensor, training
from tests.tactile_sim.sets import touch_sets
from tests.tactile_toolkit.printing.solids import box, ell, named, ring
from tests.unchanged import environments

FOLDER = Path(__file__).parent


def recorded() -> dict[str, Any]:
    """Return the record that :func:`main` wrote."""
    found: dict[str, Any] = json.loads((FOLDER / "record.json").read_text(encoding="utf-8"))
    return found


PACKAGES = (
    *("mnist3d", "starstruck_gen", "realtouch", "realtouch.touch_tensors"),
    *("tactile_sim", "env_assets", "tactile_envs"),
)
OUR_PACKAGES = {name.partition(".")[0] for name in PACKAGES} | {"tactile_toolkit"}
LIBRARIES = (
    *("pyarrow", "numpy", "scipy", "scikit-image", "simplejpeg"),
    *("pillow", "manifold3d", "trimesh", "av"),
)
"""Libraries whose versions decide bytes."""


def library_versions() -> dict[str, str]:
    return {name: version(name) for name in LIBRARIES}


def public_names(package: str) -> list[str]:
    return sorted(import_module(package).__all__)


def importable(package: str) -> dict[str, Any]:
    """Return the objects of public names, except those that need a missing extra."""
    found = {}
    for name in public_names(package):
        with suppress(MissingExtraError):
            found[name] = getattr(import_module(package), name)
    return found


def defaults_and_limits(package: str) -> dict[str, str]:
    """Return the defaults of public dataclasses, functions and methods, and which values fields take."""
    found = {}
    for name, kind in importable(package).items():
        for each in fields(kind) if isinstance(kind, type) and is_dataclass(kind) else ():
            rule = each.metadata.get("rule")
            limits = rule.expected if rule else ""
            if _is_plain(each.default) or limits:
                default = "required" if each.default is MISSING else repr(each.default)
                found[f"{name}.{each.name}"] = "; ".join(filter(None, (default, limits)))
        for called, function in _functions(name, kind):
            for each in inspect.signature(function).parameters.values():
                if each.default is not each.empty and _is_plain(each.default):
                    found[f"{called}({each.name})"] = repr(each.default)
    return found


def _is_plain(default: Any) -> bool:
    return default is None or isinstance(default, (bool, int, float, str, tuple))


def _functions(name: str, public: Any) -> Iterator[tuple[str, Any]]:
    """Yield a public function, or the public methods that a class defines here."""
    if inspect.isfunction(public):
        yield name, public
    if not inspect.isclass(public):
        return
    for method, function in inspect.getmembers(public, inspect.isroutine):
        is_ours = (getattr(function, "__module__", None) or "").partition(".")[0] in OUR_PACKAGES
        # Users call constructors with documented parameters.
        is_public = "Parameters\n" in (public.__doc__ or "") if method == "__init__" else method[0] != "_"
        if is_ours and is_public:
            yield f"{name}.{method}", function


def data_sets(folder: Path) -> dict[str, Any]:
    """Make a small data set of each kind below a folder and return the digests of all Parquet files."""
    source = SyntheticSource(seed=1)
    mnist3d.generate(mnist3d.DigitSetSpec(source, per_class=1), folder / "digits", splits=("test",))
    coarse = mnist3d.SolidSpec(profile="linear", target_vertices=2000, join_bodies=True)
    mnist3d.generate(
        mnist3d.DigitSetSpec(source, coarse, limit=2), folder / "coarse", splits=("printed_test",)
    )
    scenes = starstruck_gen.SceneSetSpec(scenes=(("train", 30), ("test", 9)))
    starstruck_gen.generate(scenes, folder / "scenes")
    rounds = [make_round(index, 6, (64, 48), (12, 16)) for index in range(3)]
    clips = str(write_set(folder / "clips", {"train": seq_rows(rounds)}, "seq"))
    images = str(write_set(folder / "images", {"train": single_rows(rounds)}, "single"))
    realtouch.clips_to_images(clips, folder / "to-single", frame="peak")
    realtouch.resize(clips, folder / "resized-clips", width=48, height=36)
    realtouch.resize(images, folder / "resized-images", width=48, height=36)
    realtouch.select(images, folder / "selected", contact=True)
    realtouch.export(clips, folder / "frames", "png")
    found = {
        str(file.relative_to(folder)): hashlib.sha256(file.read_bytes()).hexdigest()
        for file in sorted(folder.rglob("*.parquet"))
    }
    literal = mnist3d.solidify(source.image(1234).pixels, method="literal")
    content = literal.vertices_m.astype("<f4").tobytes() + literal.faces.astype("<i4").tobytes()
    return found | {"the literal solid": hashlib.sha256(content).hexdigest()}


def styles() -> dict[str, str]:
    """Return the storage layouts of digits and scenes, which decide the bytes of sets of any size."""
    return {
        rows.partition(".")[0]: repr(import_module(rows).PARQUET_STYLE)
        for rows in ("mnist3d.digit_records", "starstruck_gen.scene_dataset")
    }


def pictures(sets: Path) -> dict[str, str]:
    """Draw the sets of :func:`data_sets` and a plate, and return digests of the pixels."""
    plans = (
        mnist3d.digit_previews.plan_previews(
            str(sets / "coarse"), DigitPreviewSpec(kinds=("sheet", "steps"), per_class=2)
        ),
        starstruck_gen.kind.KIND.plan_previews(str(sets / "scenes"), PreviewSpec(split="test", per_class=2)),
        realtouch.touch_previews.plan_previews(str(sets / "clips"), TouchPreviewSpec(("grid", "overlay"))),
    )
    drawn = {planned.name: planned.draw() for plan in plans for planned in plan.pictures}
    objects = named([ell(40, 9), ring(20, 14), box(20, 12), box(8, 50)])
    layout = arrange(objects, PlateSpec(100, 80, 3.0, 2.0))
    drawn["plate"] = np.asarray(Image.open(io.BytesIO(draw_map(layout, 1))))
    return {name: hashlib.sha256(pixels.tobytes()).hexdigest() for name, pixels in drawn.items()}


def synthetic_touches(folder: Path) -> dict[str, Any]:
    """Make small sets of touches below a folder; return their digests, and other values that decide them."""
    starstruck_gen.generate(starstruck_gen.SceneSetSpec(scenes=(("train", 3),)), folder / "scenes")
    touch_sets(folder / "scenes", folder)
    files = sorted(folder.glob("touches-*/data/*.parquet"))
    digests = {str(file.relative_to(folder)): hashlib.sha256(file.read_bytes()).hexdigest() for file in files}
    return {"taxim": version("taxim"), **digests}


def _losses_of_training(folder: Path) -> dict[str, list[float]]:
    from tactile_sim import TrainRun
    from tactile_sim.learned.training import train

    folder.mkdir()
    pairs = str(folder / "pairs")
    make_pairs(*training.make_sources(folder), "train", training.SPEC, pairs)
    train(pairs, folder / "trained", training.CONFIG, TrainRun("cpu", deterministic=True))
    return training.losses_of_steps(folder / "trained")


def _line(numbers: list[float]) -> str:
    return " ".join(map(repr, numbers))


def numbers_of(line: str) -> list[float]:
    """Return numbers as they were recorded, in one line."""
    return [float(number) for number in line.split()]


def main() -> None:
    with tempfile.TemporaryDirectory() as folder:
        digests = data_sets(Path(folder) / "sets")
        pixels = pictures(Path(folder) / "sets")
        touches = synthetic_touches(Path(folder) / "touches")
        losses = _losses_of_training(Path(folder) / "training")
        made_up_sensor.write_calibration(Path(folder) / "taxim")
        shades = made_up_sensor.sums(made_up_sensor.pictures(Path(folder) / "taxim"))
        write_assets(Path(folder) / "assets")
        courses = {name: environments.course(name, Path(folder) / "assets") for name in environments.COURSES}
    found = {
        "libraries": library_versions(),
        "names": {package: public_names(package) for package in PACKAGES},
        "fields": {package: defaults_and_limits(package) for package in PACKAGES},
        "styles": styles(),
        "parquet": digests,
        "pictures": pixels,
        "touches": touches,
        "environments": environments.ids(),
        "courses": {
            name: {key: _line(values) for key, values in course.items()} for name, course in courses.items()
        },
        "made_up_sensor": _line(shades),
        "training": {name: _line(values) for name, values in losses.items()},
    }
    (FOLDER / "record.json").write_text(json.dumps(found, indent=1) + "\n", encoding="utf-8")
    record_notebooks()


if __name__ == "__main__":
    main()
