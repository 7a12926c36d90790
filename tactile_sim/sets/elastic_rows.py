"""Data of an elastic gel in a data set: random loads of each touch, and columns."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
import pyarrow as pa
from PIL import Image

from tactile_sim.press.elastic_press import Load, plate_z_m
from tactile_sim.press.markers import marker_grid_px, marker_positions_px
from tactile_sim.press.press_spec import ElasticPress, Span
from tactile_sim.press.pressing import Pressed
from tactile_sim.press.sensors import Sensor
from tactile_sim.sets.round_plan import keyed_rng
from tactile_toolkit import arithmetic, read
from tactile_toolkit.array_types import AnyArray, Float32, Float64

# The plate is met a little deeper or higher, depending on the slide and the tolerance of the solver.
_PLATE_MARGIN_M = 1e-5
_KILO, _MILLI = 1e3, 1e-3
_NONE: Span = (0.0, 0.0)


@dataclass(frozen=True, slots=True, eq=False)
class DrawnLoads:
    """Random loads of T touches: forces, newtons, or depths, metres, (T,), slides (T, 2), metres, twists."""

    force_n: Float64 | None
    depth_m: Float64 | None
    slide_m: Float64
    twist_rad: Float64

    @classmethod
    def of(cls, press: ElasticPress, touches: int, *key: str | int) -> DrawnLoads:
        """Draw the loads of a round, which depend only on its key."""
        shares = keyed_rng(*key, "press").random((touches, 4))
        far_m = _within(press.slide_m or _NONE, shares[:, 1])
        towards = np.array([arithmetic.cosine_sine(2 * np.pi * share) for share in shares[:, 2].tolist()])
        return cls(
            press.force_n and _within(press.force_n, shares[:, 0]),
            press.press_m and _within(press.press_m, shares[:, 0]),
            far_m[:, None] * towards.reshape(-1, 2) + 0.0,  # not -0.0
            _within(press.twist_rad or _NONE, shares[:, 3]),
        )


def _within(span: Span, shares: Float64) -> Float64:
    return span[0] + (span[1] - span[0]) * shares


def bare_plate_z_m(press: ElasticPress, sensor: Sensor) -> float:
    """Return the greatest height at which the sensor stops on the bare plate, metres."""
    assert press.gel is not None
    force_n, depth_m = (span and span[0] for span in (press.force_n, press.press_m))
    return plate_z_m(sensor, Load(press.gel, force_n, depth_m)) + _PLATE_MARGIN_M


def elastic_types(press: ElasticPress, size_px: tuple[int, int]) -> Mapping[str, pa.DataType]:
    """Return the types of the columns of an elastic gel, whose vectors have lengths of their own, by name."""
    number, half = pa.float32(), pa.float16()
    types: dict[str, pa.DataType] = {
        "extra.force_n": read.vectors_type(number, 3),
        "extra.torque_nm": read.vectors_type(number, 3),
        "extra.press_depth_m": pa.list_(number),
        "extra.contact_point_m": read.vectors_type(number, 2),
        "extra.slide_m": read.vectors_type(number, 2),
        "extra.twist_rad": pa.list_(number),
    }
    if press.markers is not None:
        flow = read.vectors_type(number, 2 * press.markers[0] * press.markers[1])
        types |= {"extra.marker_positions_px": flow, "extra.marker_flow_px": flow}
    if press.contact_maps:
        pixels = size_px[0] * size_px[1]
        types |= {
            "extra.pressure_kpa": read.vectors_type(half, pixels),
            "extra.displacement_mm": read.vectors_type(half, 3 * pixels),
        }
    return types


def elastic_values(
    press: ElasticPress, pressed: Pressed, loads: DrawnLoads, sensor: Sensor, size_px: tuple[int, int]
) -> dict[str, AnyArray]:
    """Return the attributes of a row of touches of an elastic gel."""
    contacts = pressed.contacts
    force_n = np.array([each.force_n for each in contacts])
    torque_nm = np.array([each.torque_nm for each in contacts])
    # Where the force of the press acts, from its moments about x and y.
    point_m = np.column_stack([-torque_nm[:, 1], torque_nm[:, 0]]) / force_n[:, 2:]
    values: dict[str, AnyArray] = {
        "force_n": force_n,
        "torque_nm": torque_nm,
        "press_depth_m": np.array([each.depth_m for each in contacts]),
        "contact_point_m": point_m,
        "slide_m": loads.slide_m,
        "twist_rad": loads.twist_rad,
    }
    values = {name: each.astype(np.float32) for name, each in values.items()}
    if press.markers is not None:
        positions_px = markers_px(press.markers, pressed, sensor, size_px)
        flow_px = positions_px - marker_grid_px(press.markers, size_px)
        for name, each in (("marker_positions_px", positions_px), ("marker_flow_px", flow_px)):
            values[name] = each.reshape(len(contacts), -1).astype(np.float32)
    if press.contact_maps:
        pressure_kpa = [_averaged(each.pressure_pa[..., None] / _KILO, size_px) for each in contacts]
        moved_mm = [_averaged(each.displacement_m / _MILLI, size_px) for each in contacts]
        for name, maps in (("pressure_kpa", pressure_kpa), ("displacement_mm", moved_mm)):
            values[name] = np.array(maps, np.float16).reshape(len(contacts), -1)
    return values


def markers_px(
    markers: tuple[int, int], pressed: Pressed, sensor: Sensor, size_px: tuple[int, int]
) -> Float64:
    """Return the positions of the markers of T touches, shape (T, rows, columns, 2), pixels."""
    moved = [
        marker_positions_px(each.displacement_m, sensor.window_m, markers, size_px)
        for each in pressed.contacts
    ]
    return np.array(moved)


def _averaged(values: Float64, size_px: tuple[int, int]) -> Float32:
    """Return maps (H, W, k) in the size of the image: means over the area of each pixel."""
    if values.shape[1::-1] == size_px:
        return values.astype(np.float32)
    parts = np.moveaxis(values, -1, 0).astype(np.float32)
    scaled = [Image.fromarray(part).resize(size_px, Image.Resampling.BOX) for part in parts]
    return np.stack([np.asarray(part, np.float32) for part in scaled], axis=-1)
