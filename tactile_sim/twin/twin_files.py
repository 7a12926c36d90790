"""Folders of sensors: ``sensor.json``, which people can read, and one file of arrays."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from tactile_sim.twin import gel, gel_kernels
from tactile_sim.twin.reader import reader_shapes
from tactile_sim.twin.twin import Twin
from tactile_sim.user_values import npz_bytes, read_npz
from tactile_toolkit import __version__, store
from tactile_toolkit.errors import InputError

if TYPE_CHECKING:
    from tactile_sim.press.sensors import SensorModel
    from tactile_toolkit.value_types import AnyArray

SENSOR_FILE, ARRAYS_FILE = "sensor.json", "arrays.npz"
_FORMAT, _VERSION = "tactile-sim sensor", 10
_MAX_BYTES = 1 << 22
_MAX_PIXELS = 1280 * 1280
_REPORTED = ("mm_per_px", "noise_levels", "image_error_levels", "residual_levels")
"""Numbers that every report must hold."""


open_sensor_output = partial(store.open_output, names=(ARRAYS_FILE, SENSOR_FILE), is_alone=True)
"""Opens the folder of a sensor to be written; InputError if it holds a sensor or other files."""


def write_sensor(folder: str, model: SensorModel, twin: Twin, *, overwrite: bool = False) -> None:
    """Write the folder of a sensor; raises as :func:`open_sensor_output`."""
    output = open_sensor_output(folder, overwrite=overwrite)
    document = {
        "format": _FORMAT,
        "version": _VERSION,
        "toolkit_version": __version__,
        "sensor": model.geometry(),
        "arrays_sha256": twin.sha256,
        "report": dict(twin.report),
    }
    text = json.dumps(document, indent=1) + "\n"
    # The document gets its name last: without it, the folder is not a sensor.
    output.write({ARRAYS_FILE: npz_bytes(twin.arrays()), SENSOR_FILE: text.encode()})


def read_sensor(folder: str | Path, names: Sequence[str]) -> tuple[dict[str, Any], Twin]:
    """Return the geometry, of values with these names, and the twin of a folder.

    InputError if the sensor is missing or damaged.
    """
    root = store.expanded(folder)
    file = root / SENSOR_FILE
    if not file.is_file():
        raise InputError(
            f"{str(folder)!r} is not a sensor: it has no {SENSOR_FILE}",
            next="give a folder that `tactile-sim calibrate` wrote",
        )
    try:
        with store.open_regular(file, root) as stream:
            document = json.loads(stream.read(_MAX_BYTES))
        stated = document["format"], document["version"]
        if stated != (_FORMAT, _VERSION):
            problem = f"its format is {stated[0]!r} {stated[1]!r}; expected {_FORMAT!r} {_VERSION}"
            raise ValueError(problem)
        geometry = dict(document["sensor"])
        if set(geometry) != set(names):
            problem = f"it states {', '.join(geometry) or 'no geometry'}; expected {', '.join(names)}"
            raise ValueError(problem)
        arrays, _ = read_npz(root / ARRAYS_FILE)
        report = dict(document["report"])
        _require_report(report)
        twin = _twin_of(arrays, report)
        if not twin.geometry.items() <= geometry.items():
            problem = f"{SENSOR_FILE} states another geometry than {ARRAYS_FILE} holds"
            raise ValueError(problem)
        if twin.sha256 != document["arrays_sha256"]:
            problem = f"{ARRAYS_FILE} has another digest than {SENSOR_FILE} states"
            raise ValueError(problem)
    except Exception as error:  # zipfile, json and numpy raise many kinds on damaged files
        raise InputError(
            f"the sensor in {str(folder)!r} cannot be read ({error})", next="copy or make it again"
        ) from error
    return geometry, twin


def _require_report(report: Mapping[str, Any]) -> None:
    """Raise ValueError unless a report has numbers and touches as a calibration writes them."""
    optional = [name for name in report if name.endswith("_detail_levels")]
    wrong = [name for name in (*_REPORTED, *optional) if not 0 <= float(report[name]) < np.inf]
    touches = [{"reason": "", **touch} for touch in report["touches"] if touch["used"] in (True, False)]
    texts = [touch[name] for touch in touches for name in ("name", "reason")]
    if wrong or len(touches) < len(report["touches"]) or not all(isinstance(text, str) for text in texts):
        problem = f"its report does not hold {', '.join([*_REPORTED, 'touches'])}"
        raise ValueError(problem)


def _twin_of(arrays: Mapping[str, AnyArray], report: Mapping[str, Any]) -> Twin:
    """Return the twin of arrays; ValueError, which names the array, for other names, types and shapes."""
    background = arrays["background"]
    if background.ndim != 3 or not background.size <= 3 * _MAX_PIXELS or min(background.shape[:2]) < 16:
        problem = f"background has the shape {background.shape}"
        raise ValueError(problem)
    expected: dict[str, tuple[Any, tuple[int, ...]]] = {
        "shape": (np.float64, (len(gel.Fitted),)),
        "half_m": (np.float64, (2,)),
        "coefficients": (np.float32, (gel_kernels.COEFFICIENTS, 3)),
        "background": (np.float32, (*background.shape[:2], 3)),
        **{f"reader_{name}": (np.float32, shape) for name, shape in reader_shapes().items()},
    }
    for name in [*expected, *arrays]:
        array, (kind, sides) = arrays.get(name), expected.get(name, (None, ()))
        if array is None or array.dtype != kind or array.shape != sides or not np.isfinite(array).all():
            problem = f"{name} is not an array of finite {np.dtype(kind)} numbers with the shape {sides}"
            raise ValueError(problem)
    shape = arrays["shape"]
    half_m = arrays["half_m"]
    is_bounded = (gel.bounded(shape, half_m, background.shape[1]) == shape).all()
    if not (is_bounded and ((half_m > 1e-4) & (half_m < 0.1)).all()):
        problem = "its geometry is out of bounds"
        raise ValueError(problem)
    reader = {name.removeprefix("reader_"): arrays[name] for name in expected if name.startswith("reader_")}
    return Twin(shape, half_m, arrays["coefficients"], background, reader, report)
