"""Small data sets to build environments on: digits, scenes, a wrench, rounds of touches."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import pyarrow as pa
import pyarrow.parquet as pq

from tactile_toolkit.mesh import MeshRow
from tests.mesh_columns import list_array
from tests.realtouch import factories

TOUCHES_PER_ROUND = 24
DIGITS = tuple(str(digit) for digit in range(10))


def write_assets(root: Path) -> None:
    """A folder for a provider: ``mnist3d``, ``starstruck``, ``wrench``, ``real-single``."""
    import mnist3d

    write_digits(root / "mnist3d")
    write_scenes(root / "starstruck")
    write_wrench(root / "wrench")
    write_touches(root / "real-single", mnist3d.load(str(root / "mnist3d"), "printed_train"))


def write_digits(folder: Path) -> None:
    """Ten digits for each of three splits."""
    from mnist3d.digit_generation import DigitSetSpec, generate
    from mnist3d.sources.synthetic import SyntheticSource

    spec = DigitSetSpec(SyntheticSource(), per_class=1)
    generate(spec, str(folder), ("train", "test", "printed_train"))


def write_scenes(folder: Path) -> None:
    """Six scenes to train with, three to test."""
    import starstruck_gen

    starstruck_gen.generate(starstruck_gen.SceneSetSpec(scenes=(("train", 6), ("test", 3))), str(folder))


def write_wrench(folder: Path) -> None:
    """One wrench."""
    import env_assets

    env_assets.write_wrench(env_assets.WrenchSpec(), str(folder))


def write_touches(folder: Path, digits: Sequence[Any]) -> None:
    """Rounds of touches of three of the printed digits."""
    rounds = [factories.make_round(index, TOUCHES_PER_ROUND, (96, 72), frames=(6, 9)) for index in range(3)]
    rows = factories.single_rows(rounds)
    for row, digit in zip(rows, digits, strict=False):
        row |= {"object_id": digit.id, "label": digit.label}
    factories.write_set(folder, {"train": rows}, "single")


def write_meshes(folder: Path, meshes: Sequence[Any], names: tuple[str, ...] = DIGITS) -> Path:
    """Write meshes with only the published columns, mesh i as row i with label i; return the folder.

    Parameters
    ----------
    folder : Path
        Where; the file becomes split ``train``.
    meshes : sequence
        Anything with ``vertices`` in metres and ``faces``.
    names : tuple of str
        Class names.
    """
    numbers = pa.array(range(len(meshes)), pa.int64())
    columns = [
        numbers,
        numbers,
        list_array([mesh.vertices for mesh in meshes], pa.float32()),
        list_array([mesh.faces for mesh in meshes], pa.int32()),
    ]
    table = pa.Table.from_arrays(columns, schema=MeshRow.schema(names))
    (folder / "data").mkdir(parents=True)
    pq.write_table(table, folder / "data" / "train-00000-of-00001.parquet")
    return folder
