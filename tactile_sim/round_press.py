"""Presses of a round, by depth or by force: images, and the columns that only some sets have."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import partial

import numpy as np
import pyarrow as pa

from tactile_sim import elastic_rows, sensor, spec_optics
from tactile_sim.markers import draw_markers
from tactile_sim.optics import Optics
from tactile_sim.pressable import Pressable
from tactile_sim.pressing import Pressed, render_touch
from tactile_sim.random_numbers import keyed_rng
from tactile_sim.sensor_noise import add_noise
from tactile_sim.touch_spec import GenerateSpec
from tactile_toolkit.array_types import Float64, UInt8
from tactile_toolkit.json_types import JsonDict
from tactile_toolkit.touch import PRESS_DEPTH_M


@dataclass(frozen=True, slots=True, eq=False)
class PressedRound:
    """T touches: how they were pressed, images (T, H, W, 3), attributes of some sets only, the sensor."""

    pressed: Pressed
    images: UInt8
    further: JsonDict
    sensor: sensor.Sensor


def press_round(
    spec: GenerateSpec, solid: Pressable, poses: Float64, targets: Float64, key: tuple[str, int, int]
) -> PressedRound:
    """Press and render the touches of a round; ``key`` is its split, object and number."""
    optics, press, further = spec_optics.optics_of(spec), spec.press, JsonDict()
    shown = _depth_sensor(spec, optics)
    if press is None:
        if spec.sensor.press_m != PRESS_DEPTH_M:
            further["plate_z_m"] = shown.press_m
        pressed = render_touch(solid, poses, targets, shown)
    else:
        loads = elastic_rows.DrawnLoads.of(press, len(targets), spec.plan.seed, *key)
        pressed = render_touch(
            solid,
            poses,
            targets,
            shown,
            gel=press.gel,
            force_n=loads.force_n,
            depth_m=loads.depth_m,
            slide_m=loads.slide_m,
            twist_rad=loads.twist_rad,
        )
        further["plate_z_m"] = elastic_rows.bare_plate_z_m(press, shown)
        further |= elastic_rows.elastic_values(press, pressed, loads, shown, spec.size_px)
    images = optics.render(pressed.depth_m, shown, spec.size_px, is_surface=press is not None)
    if press is not None and press.markers is not None and press.draw_markers:
        places = elastic_rows.markers_px(press.markers, pressed, shown, spec.size_px)
        images = np.stack([draw_markers(*each) for each in zip(images, places, strict=True)])
    return PressedRound(pressed, _with_noise(spec, images, key), further, shown)


def _depth_sensor(spec: GenerateSpec, optics: Optics) -> sensor.Sensor:
    """Return the sensor whose depth maps the optics render."""
    size_px, model = spec.size_px, spec.sensor
    if spec.window == "full":
        size_px = (model.width_px, model.height_px)
    if spec.has_other_sensor:
        return sensor.sensor_of_model(model, spec.window, optics.depth_size(*size_px))
    # Environments show the window of the pixels that they render, whatever these are scaled to.
    return sensor.sensor_of_window(spec.window, optics.depth_size(*size_px))


def _with_noise(spec: GenerateSpec, images: UInt8, key: tuple[str, int, int]) -> UInt8:
    """Return the images of a round with the noise of the specification, drawn for each round."""
    if spec.noise is None:
        return images
    draw = partial(keyed_rng, spec.plan.seed, *key, "noise")
    if spec.optics == "depth":  # grey
        return np.repeat(add_noise(images[..., :1], spec.noise, draw(), draw), 3, axis=-1)
    return add_noise(images, spec.noise, draw(), draw)


def further_types(spec: GenerateSpec) -> Mapping[str, pa.DataType]:
    """Return the types of the columns that only some sets have; a GelSight Mini has the published ones."""
    types: dict[str, pa.DataType] = {}
    if spec.press is not None or spec.sensor.press_m != PRESS_DEPTH_M:
        types["plate_z_m"] = pa.float64()
    if spec.press is not None:
        types |= elastic_rows.elastic_types(spec.press, spec.size_px)
    return types
