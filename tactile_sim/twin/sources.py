"""Read recordings for a calibration: a data set of touches or a folder of images, and the solids."""

from __future__ import annotations

import os
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from os import PathLike, fspath
from pathlib import Path
from typing import Any

import numpy as np

from tactile_sim.kind import KIND
from tactile_sim.sets.touch_table import meaning_of
from tactile_sim.sets.touched_solids import given_solids, open_split
from tactile_sim.twin.recordings import Recordings
from tactile_toolkit import places, store, touch
from tactile_toolkit.columns import known_formats, tables, units
from tactile_toolkit.errors import InputError
from tactile_toolkit.mesh import Mesh
from tactile_toolkit.value_types import Float64, UInt8

MAX_TOUCHES = 60
"""Greatest number of touches that are used, evenly spaced; 20 are enough, and time grows with the number."""

_SENSOR = ("x_m", "y_m", "z_m")
_OBJECT = ("object_x_m", "object_y_m", "object_turn_rad")
_OBJECT_NAMES = ("object", "object_id")
_POSES_OF_OBJECT = ("touched_object_pose", "object_pose")
_SUFFIXES = (".png", ".jpg", ".jpeg", ".webp")


@dataclass(frozen=True)
class _Touched:
    """One touch: its name, image, solid (None: not stated), and numbers by name, metres and radians."""

    name: str
    image: UInt8
    object_id: int | None
    numbers: Mapping[str, float]


def read_recordings(
    source: str | PathLike[str],
    solids: str | PathLike[str],
    *,
    table: str | PathLike[str] | None = None,
    backgrounds: Sequence[str | PathLike[str]] = (),
    unit: str | None = None,
    opened: Callable[[Any], places.Place] = places.open_place,
) -> Recordings:
    """Read touches of known solids.

    Parameters
    ----------
    source : str or path
        Data set of touches, or a folder of images.
    solids : str or path
        Mesh file, folder of mesh files, or data set of meshes; of a folder, solids are numbered from 0 in the
        order of their names.
    table : str or path, optional
        CSV or TSV with a line for each image: ``file``; ``object``, the id of the solid; ``x_m``, ``y_m``,
        ``z_m`` of the sensor; ``object_x_m``, ``object_y_m``, ``object_turn_rad`` of the solid. By default
        the only table in the folder, if there is one.
    backgrounds : sequence of str or path
        Images without contact, or folders of them.
    unit : "mm", "cm", "m" or "in", optional
        Unit of STL, PLY and OBJ files; millimetres by default.
    opened : callable
        Opens a data set by its name.

    Returns
    -------
    Recordings

    Raises
    ------
    InputError
        The source, the table, an image or the solids cannot be used.
    IntegrityError, HubError
        A data set is damaged, or cannot be fetched.
    """
    root = store.expanded(fspath(source))
    images = image_paths(root)
    if images or table is not None:
        touches = _of_folder(root, images, table)
    else:
        touches = _of_data_set(opened(source))
    if not touches:
        raise InputError(f"{str(source)!r} holds no touches", next="give images, or another data set")
    touches = [touches[number] for number in spaced(len(touches), MAX_TOUCHES)]
    meshes = _solids(solids, {touched.object_id for touched in touches}, unit, opened)
    ids = [_solid_of(touched, meshes) for touched in touches]
    return Recordings(
        _one_array([touched.image for touched in touches]),
        np.array(ids, np.int64),
        meshes,
        _read_backgrounds(backgrounds, touches[0].image),
        sensor_m=_columns(touches, _SENSOR, required=_SENSOR[:2]),
        object_poses=_columns(touches, _OBJECT),
        names=tuple(touched.name for touched in touches),
    )


def _one_array(images: Sequence[UInt8]) -> UInt8:
    """Return images in one array; InputError if their sizes differ."""
    shapes = {image.shape for image in images}
    if len(shapes) > 1:
        sizes = ", ".join(f"{width} x {height}" for height, width, *_ in sorted(shapes)[:4])
        raise InputError(f"images have the sizes {sizes}; expected one size", next="scale them first")
    return np.stack(images)


def image_paths(root: Path) -> list[Path]:
    """Return the image files of a folder that is no data set, in natural order."""
    if not root.is_dir() or (root / store.MANIFEST_FILE).exists() or next(root.glob("**/*.parquet"), None):
        return []
    return store.list_files(root, _SUFFIXES)


def read_image(file: Path, root: Path | None = None) -> UInt8:
    """Decode an image file; InputError if it is not an image."""
    try:
        with store.open_regular(file, root) as stream:
            return touch.decode_image(stream.read(touch.MAX_IMAGE_BYTES + 1))
    except FileNotFoundError as error:
        raise InputError(f"there is no image {str(file)!r}", next="check its name in the table") from error
    except (OSError, ValueError) as error:
        known = known_formats.KnownFormat.of_file(file)
        if known is not None:
            raise InputError(f"{str(file)!r} is {known.name}; expected an image", next=known.step) from error
        raise InputError(
            f"{str(file)!r} cannot be read as an image ({error})",
            next="replace it by an intact copy, or leave it out",
        ) from error


def _of_folder(root: Path, images: list[Path], table: str | PathLike[str] | None) -> list[_Touched]:
    """Read the images of a folder, with the solids and poses that a table states for them."""
    beside = store.list_files(root, tables.Table.TEXT_ENDINGS)
    if table is None and len(beside) > 1:
        names = ", ".join(file.name for file in beside[:4])
        raise InputError(f"{str(root)!r} holds the tables {names}", next="choose one with --table")
    file = beside[0] if table is None and beside else table
    if file is None:
        return [_Touched(file.name, read_image(file, root), None, {}) for file in images]
    file_path = store.expanded(fspath(file))
    read = tables.Table.of(*store.split_uri(os.path.realpath(file_path)))
    columns = read.names
    numeric = [name for name in columns if name in _OBJECT_NAMES or units.Quantity.stated_unit(name)]
    values = {name: column.to_pylist() for name, column in read.whole(["file"], numeric).items()}
    for name in numeric:
        values[name] = _numbers(values[name], name, repr(str(file_path)))
    lines = [dict(zip(values, row, strict=True)) for row in zip(*values.values(), strict=True)]
    if "file" not in columns:
        raise InputError(
            f"{str(file_path)!r} has the columns {', '.join(columns)[:200]}; expected file, and of each "
            f"touch {', '.join((_OBJECT_NAMES[0], *_SENSOR, *_OBJECT))}"
        )
    store.names_inside([str(line["file"]) for line in lines], repr(str(file_path)))
    return [
        _of_line(root, line, f"{str(file_path)!r}, line {number + 2}") for number, line in enumerate(lines)
    ]


def _of_line(root: Path, line: Mapping[str, Any], line_name: str) -> _Touched:
    numbers: dict[str, float] = {}
    object_id = None
    for name, value in line.items():
        if value in (None, ""):
            continue
        meaning = meaning_of(name, (*_SENSOR, *_OBJECT))
        if meaning is not None:
            numbers[meaning[0]] = value / meaning[1]
        if name in _OBJECT_NAMES:
            object_id = int(value)
            if object_id != value:
                raise InputError(f"{line_name}: {name} is {value!r}; expected the id of a solid, an integer")
    name = str(line["file"])
    return _Touched(name, read_image(root / name, root), object_id, numbers)


def _numbers(values: Sequence[Any], name: str, table_name: str) -> list[float | None]:
    """Return the numbers of a column, None for a missing one; InputError, which names it, for anything else.

    One word makes all of a column text: the word is named, not the numbers beside it.
    """
    for row, value in enumerate(values):
        if value is not None and not _is_number(value):
            raise InputError(f"{table_name}, line {row + 2}: {name} is {value!r}; expected a number")
    return [None if value is None else float(value) for value in values]


def _is_number(value: Any) -> bool:
    try:
        return bool(np.isfinite(float(value))) and "_" not in str(value)
    except ValueError:
        return False


def spaced(count: int, most: int) -> list[int]:
    """Return evenly spaced integers below a count, at most ``most``."""
    return [int(number) for number in np.unique(np.linspace(0, count - 1, min(count, most)).round())]


def _of_data_set(dataset: places.Place) -> list[_Touched]:
    """Read the touches of all splits of a data set, with their poses or columns named as those of a table."""
    dataset.require(KIND, "tactile-sim calibrate")
    parts = [KIND.load(dataset, split).touches() for split in dataset.splits]
    flat = [(part, number) for part in parts for number in range(len(part))]
    return [_of_touch(flat[number][0][flat[number][1]]) for number in spaced(len(flat), MAX_TOUCHES)]


def _of_touch(recorded: Any) -> _Touched:
    extra = recorded.extra
    names = [*_SENSOR, *_OBJECT]
    numbers = {name: float(extra[name]) for name in names if name in extra and np.isfinite(extra[name])}
    object_id = None
    if recorded.round.row.has("object_id"):
        object_id = int(recorded.object_id)
    elif "object" in extra:
        object_id = int(extra["object"])
    if recorded.round.row.has_poses:
        numbers |= _poses_in_image_frame(recorded)
    return _Touched(recorded.id, recorded.image, object_id, numbers)


def _poses_in_image_frame(recorded: Any) -> dict[str, float]:
    """Return the poses of sensor and solid by column, turned about z so that the x axis of the gel is x."""
    gel = recorded.gel_pose
    x_axis = gel.matrix[:3, 0]
    yaw = np.arctan2(x_axis[1], x_axis[0])
    back = np.array([[np.cos(yaw), np.sin(yaw)], [-np.sin(yaw), np.cos(yaw)]])
    sensor = [*(back @ gel.translation[:2]), gel.translation[2]]
    numbers = dict(zip(_SENSOR, map(float, sensor), strict=True))
    info = recorded.round.info if recorded.round.row.has_info() else {}
    pose = next((info[name] for name in _POSES_OF_OBJECT if name in info), None)
    if pose is not None:
        matrix = np.asarray(pose.matrix)
        matrix = matrix[recorded.touch_index] if matrix.ndim == 3 else matrix
        turn = np.arctan2(matrix[1, 0], matrix[0, 0]) - yaw
        numbers |= dict(zip(_OBJECT, map(float, (*(back @ matrix[:2, 3]), turn)), strict=True))
    return numbers


def _columns(
    touches: Sequence[_Touched], names: Sequence[str], required: Sequence[str] = ()
) -> Float64 | None:
    """Return numbers of all touches, (N, 3): NaN for a height that is not stated, 0 for other gaps.

    Return None if no touch states any of them; InputError if some touches lack a required one.
    """
    if not any(name in touched.numbers for touched in touches for name in names):
        return None
    missing = [touched.name for touched in touches if not all(name in touched.numbers for name in required)]
    if missing:
        raise InputError(
            f"{len(missing)} of {len(touches)} touches have no position, {missing[0]!r} first; expected "
            f"{' and '.join(required)} for all, or for none"
        )
    gaps = [np.nan if name == "z_m" else 0.0 for name in names]
    defaults = list(zip(names, gaps, strict=True))
    rows = [[touched.numbers.get(name, gap) for name, gap in defaults] for touched in touches]
    return np.array(rows, np.float64)


def _solids(
    source: str | PathLike[str],
    object_ids: set[int | None],
    unit: str | None,
    opened: Callable[[Any], places.Place],
) -> dict[int, Mesh]:
    """Return the meshes of the solids that touches name; all given ones if a touch names none."""
    splits = given_solids(source, unit)
    if splits is not None:
        solids = [solid for of_split in splits.values() for solid in of_split.solids]
        chosen = solids if None in object_ids else [solid for solid in solids if solid.id in object_ids]
        return {solid.id: solid.mesh() for solid in chosen or solids}
    dataset = opened(source).require_complete()
    meshes: dict[int, Mesh] = {}
    for split in dataset.splits:
        held = open_split(dataset, split)
        for row, number in enumerate(held.ids.tolist()):
            if number in object_ids and number not in meshes:
                meshes[number] = Mesh.of(held[row])
    return meshes


def _solid_of(touched: _Touched, meshes: Mapping[int, Mesh]) -> int:
    if touched.object_id is not None:
        return touched.object_id
    if len(meshes) == 1:
        return next(iter(meshes))
    raise InputError(
        f"touch {touched.name!r} does not name the solid that was touched",
        next="add a column `object` with the id of the solid to the table",
    )


def _read_backgrounds(sources: Sequence[str | PathLike[str]], like: UInt8) -> UInt8:
    files: list[Path] = []
    for source in sources:
        path = store.expanded(fspath(source))
        files += image_paths(path) if path.is_dir() else [path]
    if not files:
        return np.empty((0, *like.shape), np.uint8)
    images = [read_image(file) for file in files]
    for file, image in zip(files, images, strict=True):
        if image.shape != like.shape:
            raise InputError(
                f"the image without contact {str(file)!r} has {image.shape[1]} x {image.shape[0]} pixels; "
                f"expected {like.shape[1]} x {like.shape[0]}, like the touches"
            )
    return np.stack(images)
