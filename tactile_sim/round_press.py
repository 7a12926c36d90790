"""Pressing the touches of a round, by depth or by force: images, and the columns that not all sets have."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
import pyarrow as pa

from tactile_sim.elastic_rows import DrawnLoads, bare_plate_z_m, elastic_types, elastic_values, markers_px
from tactile_sim.markers import draw_markers
from tactile_sim.optics import Optics
from tactile_sim.pressable import Pressable
from tactile_sim.pressing import Pressed, render_touch
from tactile_sim.sensor import Sensor
from tactile_sim.touch_spec import GenerateSpec
from tactile_toolkit.array_types import Float64, UInt8
from tactile_toolkit.touch import PRESS_DEPTH_M


def pressed_round(
    spec: GenerateSpec,
    solid: Pressable,
    poses: Float64,
    targets: Float64,
    sensor: Sensor,
    key: tuple[str, int, int],
) -> tuple[Pressed, dict[str, Any]]:
    """Press the touches of a round; return also the attributes that not all sets have."""
    press = spec.press
    if press is None:
        further = {}
        if spec.sensor.press_m != PRESS_DEPTH_M:
            further["plate_z_m"] = sensor.press_m
        return render_touch(solid, poses, targets, sensor), further
    loads = DrawnLoads.of(press, len(targets), spec.plan.seed, *key)
    pressed = render_touch(solid, poses, targets, sensor, gel=press.gel, **loads.keywords())
    values = elastic_values(press, pressed, loads, sensor, spec.size_px)
    return pressed, {"plate_z_m": bare_plate_z_m(press, sensor), **values}


def images_without_noise(spec: GenerateSpec, optics: Optics, sensor: Sensor, pressed: Pressed) -> UInt8:
    """Return the images of n touches, (n, H, W, 3), without noise."""
    press = spec.press
    pictures = optics.render(pressed.depth_m, sensor, spec.size_px, is_surface=press is not None)
    if press is None or press.markers is None or not press.draw_markers:
        return pictures
    places = markers_px(press.markers, pressed, sensor, spec.size_px)
    return np.stack([draw_markers(*each) for each in zip(pictures, places, strict=True)])


def further_types(spec: GenerateSpec) -> Mapping[str, pa.DataType]:
    """Return the types of the columns that not all sets have: those of a GelSight Mini are as published."""
    types: dict[str, pa.DataType] = {}
    if spec.press is not None or spec.sensor.press_m != PRESS_DEPTH_M:
        types["plate_z_m"] = pa.float64()
    if spec.press is not None:
        types |= elastic_types(spec.press, spec.size_px)
    return types
