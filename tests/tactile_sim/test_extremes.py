"""Extreme values through every parameter of the public functions of tactile_sim.

Each ends in a result of finite numbers or in an error of the toolkit, never in another exception, and never
in the kernels of a compiled loop with numbers that these cannot take.
"""

from __future__ import annotations

import dataclasses
import inspect
from collections.abc import Callable, Iterator, Mapping
from importlib.util import find_spec

import numpy as np
import pytest

import tactile_sim
from tactile_toolkit.errors import ToolkitError
from tests.tactile_sim.made_up_twin import made_up_sensor
from tests.tactile_sim.solids import ball


def far_pose(x_m: float) -> np.ndarray:
    pose = np.eye(4)
    pose[0, 3] = x_m
    return pose


NUMBERS = (float("nan"), float("inf"), -float("inf"), 1e308, -1e308, 1e6, -1e6, 5e-324, 0, -1, 2**63, 10**400)
OTHERS = ("", "x", b"x", True, [], (), {}, [[]], object(), 1j, [1, [2]], np.datetime64("nat"))
ARRAYS = (
    np.empty(0),
    np.empty((0, 3)),
    np.array(1e308),
    np.full((1, 1), np.nan),
    np.full((4, 4), np.inf),
    np.full((2, 3, 4, 5), 1e308),
    np.array(["a"]),
    np.array([object()]),
    np.ones((2, 2), complex),
    np.ones((3, 3), np.uint8),
    np.ones((1, 40, 40, 3), np.uint8),
    np.full(3, 1e6),
    *(far_pose(number) for number in (1e308, 1e6, float("nan"))),
    np.full(2, -1e308),
    np.broadcast_to(np.float32(1), (1 << 20, 1 << 20)),
    np.broadcast_to(np.uint8(1), (1 << 20, 1 << 12, 1 << 12, 3)),
)
EXTREMES = (*NUMBERS, *OTHERS, *ARRAYS, *(tuple([number] * 2) for number in NUMBERS))

SENSOR = tactile_sim.center_view(32, 24)
MODEL = made_up_sensor()
IMAGES = np.full((1, 48, 64, 3), 100, np.uint8)
DEPTH_M = np.full((1, 24, 32), 0.003)
PRESSABLE = tactile_sim.Pressable.of(ball(subdivisions=1))
OPTICS = {
    name: tactile_sim.make_optics(name) for name in ("depth", *(["taxim"] if find_spec("taxim") else []))
}
NOISE = tactile_sim.SensorNoise.white(0.01)
RECORDINGS = {
    "images": np.full((2, 48, 64, 3), 100, np.uint8),
    "object_ids": np.zeros(2, np.int64),
    "solids": {0: ball(subdivisions=1)},
    "backgrounds": IMAGES,
    "sensor_m": np.zeros((2, 3)),
    "object_poses": np.zeros((2, 3)),
}
CALLS: Mapping[str, tuple[Callable[..., object], Mapping[str, object]]] = {
    "Gel": (tactile_sim.Gel, {}),
    "solve_contact": (
        tactile_sim.solve_contact,
        {
            "height_m": np.eye(8) * 1e-4,
            "pixel_m": 1e-4,
            "load": tactile_sim.GelLoad(1.0),
            "thickness_m": 4e-3,
        },
    ),
    "solve_contact: load": (
        lambda **load: tactile_sim.solve_contact(
            np.eye(8) * 1e-4, 1e-3, tactile_sim.GelLoad(**load), thickness_m=4e-3
        ),
        {"force_n": 1.0, "slide_m": (0.0, 0.0), "twist_rad": 0.0},
    ),
    "fit_youngs_modulus": (
        tactile_sim.fit_youngs_modulus,
        {
            "depth_m": [0.0, 1e-4],
            "force_n": [0.0, 1.0],
            "thickness_m": 4e-3,
            "pad_m": (0.02, 0.02),
            "ball_radius_m": None,
            "post_radius_m": None,
            "gel": None,
        },
    ),
    "Shape": (tactile_sim.Shape, {"kind": "box", "size_m": (0.01, 0.01, 0.01)}),
    "press_at": (
        tactile_sim.press_at,
        {
            "solids": [tactile_sim.Shape("sphere", (0.004,))],
            "object_poses": tactile_sim.pose(0.0, 0.0, -0.0035),
            "sensor_pose": tactile_sim.pose(),
            "sensor": SENSOR,
            "gel": tactile_sim.Gel(),
        },
    ),
    "GelState": (tactile_sim.GelState, {"sensor": SENSOR}),
    "marker_grid_px": (tactile_sim.marker_grid_px, {"markers": (2, 3), "size_px": (32, 24)}),
    "marker_positions_px": (
        tactile_sim.marker_positions_px,
        {
            "displacement_m": np.zeros((24, 32, 3)),
            "window_m": (0.01, 0.01),
            "markers": (2, 3),
            "size_px": (32, 24),
        },
    ),
    "make_optics": (tactile_sim.make_optics, {"name": "depth"}),
    "pose": (tactile_sim.pose, {}),
    "render_touch": (
        tactile_sim.render_touch,
        {
            "solid": PRESSABLE,
            "object_pose": tactile_sim.pose(),
            "sensor_pose": tactile_sim.pose(),
            "sensor": SENSOR,
            "cell_m": (0.1, 0.1),
            "load": None,
        },
    ),
    "render_touch: load": (
        lambda **load: tactile_sim.render_touch(
            PRESSABLE, tactile_sim.pose(), tactile_sim.pose(), SENSOR, load=tactile_sim.GelLoad(**load)
        ),
        {"force_n": 1.0, "slide_m": (0.0, 0.0), "twist_rad": 0.0},
    ),
    **{
        f"render_touch: sensor {kind}": (
            lambda load=load, **sensor: tactile_sim.render_touch(
                PRESSABLE, tactile_sim.pose(), tactile_sim.pose(), tactile_sim.Sensor(**sensor), load=load
            ),
            {name: getattr(SENSOR, name) for name in SENSOR.__slots__},
        )
        for kind, load in (("rigid", None), ("elastic", tactile_sim.GelLoad(1.0)))
    },
    "ElasticPress": (tactile_sim.ElasticPress, {}),
    "Pressable.of": (tactile_sim.Pressable.of, {"solid": ball(subdivisions=1), "layer_m": 0.0}),
    "center_view": (tactile_sim.center_view, {}),
    "full_view": (tactile_sim.full_view, {}),
    "Sensor": (tactile_sim.Sensor, {"size_px": (32, 24)}),
    "SensorModel": (tactile_sim.SensorModel, {name: getattr(MODEL, name) for name in MODEL.geometry_names()}),
    "SensorModel.named": (tactile_sim.SensorModel.named, {"word": "digit"}),
    "SensorModel.read_depth_m": (MODEL.read_depth_m, {"images": IMAGES}),
    "SensorModel.render_read": (MODEL.render_read, {"depth_m": np.zeros((1, 48, 64), np.float32)}),
    "Sensor.depth_image": (SENSOR.depth_image, {"depth_m": DEPTH_M}),
    "check_sensor": (tactile_sim.check_sensor, {"model": MODEL, "images": [IMAGES[0]] * 5}),
    "find_mistakes": (
        tactile_sim.find_mistakes,
        {"recordings": tactile_sim.Recordings(**RECORDINGS), "start": MODEL},
    ),
    "calibrate": (tactile_sim.calibrate, {"recordings": tactile_sim.Recordings(**RECORDINGS)}),
    "Recordings": (tactile_sim.Recordings, RECORDINGS),
    "SensorNoise": (tactile_sim.SensorNoise, dataclasses.asdict(NOISE)),
    "SensorNoise.white": (tactile_sim.SensorNoise.white, {"deviation": 0.01}),
    "preview_touch": (
        tactile_sim.preview_touch,
        {
            "mesh": ball(subdivisions=1),
            "spec": tactile_sim.TouchSetSpec((16, 16), "depth"),
            "at_m": (0.0, 0.0),
            "turn_rad": 0.0,
        },
    ),
    "plan_round": (
        tactile_sim.plan_round,
        {
            "plan": tactile_sim.TouchPlan(1, 2),
            "solid": PRESSABLE,
            "split": "train",
            "object_id": 0,
            "number": 0,
        },
    ),
    "TouchPlan": (tactile_sim.TouchPlan, {}),
    "TouchTable": (tactile_sim.TouchTable, {"x_m": [0.0], "y_m": [0.0]}),
    "TouchSetSpec": (tactile_sim.TouchSetSpec, {"optics": "depth"}),
    "PairSetSpec": (tactile_sim.PairSetSpec, {}),
    "GraspSpec": (tactile_sim.GraspSpec, {"optics": "depth"}),
    "TrainConfig": (tactile_sim.TrainConfig, {}),
    "TrainRun": (tactile_sim.TrainRun, {}),
    **{
        f"{name} render": (
            optics.render,
            {"depth_m": DEPTH_M, "sensor": SENSOR, "size_px": (32, 24)},
        )
        for name, optics in OPTICS.items()
    },
    "twin render": (
        MODEL.optics.render,
        {"depth_m": np.full((1, 48, 64), 0.003), "sensor": MODEL.sensor, "size_px": (64, 48)},
    ),
}


OBJECTS = (bool, tactile_sim.Pressable, tactile_sim.Recordings, type(ball()))


NOT_TRIED = {
    *(
        "GelWarning",
        "ElasticContact",
        "GelFit",
        "Pressed",
        "Mistake",
        "SensorHealth",
        "TouchPreview",
    ),  # results
    "GelLoad",  # is checked where it is used
    *(
        "TouchGenerator",
        "PairGenerator",
        "GraspGenerator",
        "generate",
        "make_pairs",
    ),  # take specifications and names
    *("read_recordings", "images_of"),  # take names
}


def parameters() -> Iterator[tuple[str, str]]:
    """Yield all parameters that take numbers, arrays or texts, by the names of their functions."""
    for name, (function, arguments) in CALLS.items():
        for parameter in inspect.signature(function).parameters.values():
            named = arguments if parameter.kind is inspect.Parameter.VAR_KEYWORD else [parameter.name]
            for argument in named:
                value = arguments.get(argument, parameter.default)
                if (
                    not isinstance(value, OBJECTS)
                    and not dataclasses.is_dataclass(value)
                    and not callable(value)
                ):
                    yield name, argument


def numbers_of(result: object) -> Iterator[np.ndarray]:
    """Yield the arrays and numbers of a result."""
    if isinstance(result, (float, np.ndarray)):
        yield np.asarray(result)
    elif dataclasses.is_dataclass(result):
        for field in dataclasses.fields(result):
            yield from numbers_of(getattr(result, field.name))


@pytest.mark.parametrize(("name", "parameter"), tuple(parameters()))
@pytest.mark.filterwarnings("ignore::RuntimeWarning")
def test_extremes_are_refused_or_give_finite_numbers(name, parameter):
    function, arguments = CALLS[name]
    for value in EXTREMES:
        try:
            result = function(**{**arguments, parameter: value})
        except ToolkitError:
            continue
        for array in numbers_of(result) if not inspect.isclass(function) else ():
            assert array.dtype.kind not in "fc" or not np.isinf(array).any(), value


def test_all_public_functions_are_tried():
    tried = {name.split(":")[0].split(".")[0] for name in CALLS}
    assert {*dir(tactile_sim)} >= NOT_TRIED
    # One of those needs an extra.
    assert {name for name in {*dir(tactile_sim)} - NOT_TRIED if callable(getattr(tactile_sim, name))} <= tried
