"""Presses of a round or of a single touch: images, and the columns that only some sets have."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import lru_cache, partial

import numpy as np
import pyarrow as pa
from numpy.typing import ArrayLike
from PIL import Image

from tactile_sim.elastic.contact import GelLoad
from tactile_sim.optics.rendering import Optics, make_optics
from tactile_sim.optics.sensor_noise import add_noise
from tactile_sim.press import sensors
from tactile_sim.press.elastic_press import draw_markers, marker_grid_px, marker_positions_px, plate_z_m
from tactile_sim.press.press_spec import ElasticPress, Span
from tactile_sim.press.pressable import Pressable
from tactile_sim.press.pressing import Pressed, pose, render_touch
from tactile_sim.sets.round_plan import keyed_rng, on_object
from tactile_sim.sets.set_options import TouchSetSpec
from tactile_sim.user_values import finite_array
from tactile_toolkit import arithmetic, read, store, touch
from tactile_toolkit.mesh import MeshLike
from tactile_toolkit.value_types import AnyArray, Float32, Float64, JsonDict, UInt8

# On a surface as large as the cell they are two millimetres apart.
_POINTS = 4096
_SHOWN = ("force_n", "torque_n_m", "press_depth_m", "slide_m", "twist_rad", "marker_flow_px")
# The plate is met a little deeper or higher, depending on the slide and the tolerance of the solver.
_PLATE_MARGIN_M = 1e-5
_KILO, _MILLI = 1e3, 1e-3
_NONE: Span = (0.0, 0.0)


def optics_of(spec: TouchSetSpec) -> Optics:
    """Return the optics of a specification, made once in a process and again when the weights change."""
    if spec.optics == "twin":
        twin: Optics = spec.sensor.optics
        return twin
    if spec.weights is None:
        return _optics(spec.optics, None, ())
    file = store.expanded(spec.weights)
    if not file.is_file():  # refused with its name
        return make_optics(spec.optics, spec.weights)
    # A notebook may train into the same file again and again; the manifest has the checksum of the new one.
    facts = file.stat()
    return _optics(spec.optics, spec.weights, (facts.st_ino, facts.st_size, facts.st_mtime_ns))


@lru_cache(maxsize=2)
def _optics(name: str, weights: str | None, _stamp: tuple[int, ...]) -> Optics:
    # Tables and networks take longer to load than a round to render.
    return make_optics(name, weights)


@dataclass(frozen=True, slots=True, eq=False)
class PressedRound:
    """T touches: how they were pressed, images (T, H, W, 3), attributes of some sets only, the sensor."""

    pressed: Pressed
    images: UInt8
    further: JsonDict
    sensor: sensors.Sensor


def press_round(
    spec: TouchSetSpec, solid: Pressable, poses: Float64, targets: Float64, key: tuple[str, int, int]
) -> PressedRound:
    """Press and render the touches of a round; ``key`` is its split, object and number."""
    press = spec.press
    further = JsonDict()
    shown = depth_sensor(spec)
    if press is None:
        if spec.sensor.press_m != touch.PRESS_DEPTH_M:
            further["plate_z_m"] = shown.press_m
        pressed = render_touch(solid, poses, targets, shown)
    else:
        load = drawn_load(press, len(targets), spec.plan.seed, *key)
        pressed = render_touch(solid, poses, targets, shown, load=load)
        further["plate_z_m"] = bare_plate_z_m(press, shown)
        motion = np.asarray(load.slide_m), np.asarray(load.twist_rad)
        further |= elastic_values(press, pressed, motion, shown, spec.size_px)
    return PressedRound(pressed, images_of_round(spec, pressed, shown, key), further, shown)


def images_of_round(
    spec: TouchSetSpec, pressed: Pressed, sensor: sensors.Sensor, key: tuple[str, int, int]
) -> UInt8:
    """Return the images of the touches of a round, with markers and noise if its set has them."""
    press = spec.press
    images = pressed.render(optics_of(spec), sensor, spec.size_px)
    if press is not None and press.markers is not None and press.draw_markers:
        positions_px = markers_px(press.markers, pressed, sensor, spec.size_px)
        images = np.stack([draw_markers(*pair) for pair in zip(images, positions_px, strict=True)])
    return _with_noise(spec, images, key)


def depth_sensor(spec: TouchSetSpec) -> sensors.Sensor:
    """Return the sensor whose depth maps the optics of a specification render."""
    optics = optics_of(spec)
    size_px = spec.size_px
    model = spec.sensor
    if spec.window == "full":
        size_px = (model.width_px, model.height_px)
    if spec.has_other_sensor:
        return sensors.sensor_of_model(model, spec.window, optics.depth_size(*size_px))
    # Environments show the window of the pixels that they render, whatever these are scaled to.
    return sensors.sensor_of_window(spec.window, optics.depth_size(*size_px))


def _with_noise(spec: TouchSetSpec, images: UInt8, key: tuple[str, int, int]) -> UInt8:
    """Return the images of a round with the noise of the specification, drawn for each round."""
    if spec.noise is None:
        return images
    draw = partial(keyed_rng, spec.plan.seed, *key, "noise")
    if spec.optics == "depth":  # grey
        return np.repeat(add_noise(images[..., :1], spec.noise, draw(), draw), 3, axis=-1)
    return add_noise(images, spec.noise, draw(), draw)


def further_types(spec: TouchSetSpec) -> Mapping[str, pa.DataType]:
    """Return the types of the columns that only some sets have; a GelSight Mini has the published ones."""
    types: dict[str, pa.DataType] = {}
    if spec.press is not None or spec.sensor.press_m != touch.PRESS_DEPTH_M:
        types["plate_z_m"] = pa.float64()
    if spec.press is not None:
        types |= elastic_types(spec.press, spec.size_px)
    return types


@dataclass(frozen=True, slots=True, eq=False)
class TouchPreview:
    """One touch.

    Attributes
    ----------
    picture : ndarray of uint8, shape (H, W, 3)
        The image.
    sensor_z_m : float
        Height of the sensor, metres.
    contact : float
        Share of the image in which the gel touches the object; 0 if it touches only the plate.
    bounds_m : ndarray of float64, shape (2, 2)
        Least, then greatest x and y of the object in its pose, metres, cell frame.
    forces : dict
        ``force_n``, ``torque_n_m``, ``press_depth_m``, ``slide_m`` and ``twist_rad`` of an elastic gel, and
        ``marker_flow_px`` if it has markers, as lists and numbers; empty for other gels. See
        ``tactile_sim.sets.generation.SyntheticRound``.
    """

    picture: UInt8
    sensor_z_m: float
    contact: float
    bounds_m: Float64
    forces: JsonDict = field(default_factory=dict)


def preview_touch(
    mesh: MeshLike, spec: TouchSetSpec, at_m: tuple[float, float] | None, turn_rad: float = 0.0
) -> TouchPreview:
    """Press the gel once onto a solid that stands on the plate.

    Parameters
    ----------
    mesh : Mesh, record or trimesh.Trimesh
        A closed mesh, metres.
    spec : TouchSetSpec
        What the touch looks like; its plan is not used.
    at_m : tuple of float or None
        Where the gel goes, x and y from the solid's own origin, metres. None puts the solid
        under the gel with the point that is nearest to its middle, as seen from above.
    turn_rad : float
        Rotation of the solid about z, radians.

    Returns
    -------
    TouchPreview

    Raises
    ------
    InputError
        As :func:`tactile_sim.render_touch`.
    """
    solid = Pressable.of(mesh, layer_m=spec.layer_m)
    stands = pose(z_m=-solid.foot_m, turn_rad=turn_rad)
    x_m = y_m = 0.0
    if at_m is not None:
        x_m, y_m = finite_array(at_m, "at_m", (2,), "x and y, metres", most=1.0).tolist()
    else:
        # A ring has no point in its middle.
        points_m = on_object(_POINTS, solid, np.tile(stands, (_POINTS, 1, 1)), keyed_rng("look"))
        offsets_m = points_m - _bounds_m(solid, stands).mean(axis=0)
        stands[:2, 3] = -points_m[np.argmin((offsets_m**2).sum(axis=1))]
    # Noise and slides are drawn as for round 0 of object 0, so that they are the same each time.
    made = press_round(spec, solid, stands[None], pose(x_m, y_m)[None], ("look", 0, 0))
    sensor_z_m = float(np.ravel(made.pressed.sensor_z_m)[0])
    depth_m = made.pressed.depth_m[0]
    is_contact = depth_m < made.sensor.gel_m
    if made.pressed.contacts:
        is_contact = made.pressed.contact.is_contact
    touched = float((is_contact & (sensor_z_m - depth_m >= touch.HeightRule.RENDERED_M)).mean())
    forces = {name: made.further[name][0].tolist() for name in _SHOWN if name in made.further}
    return TouchPreview(made.images[0], sensor_z_m, touched, _bounds_m(solid, stands), forces)


def _bounds_m(solid: Pressable, stands: Float64) -> Float64:
    corners_m = solid.vertices_m @ stands[:2, :3].T + stands[:2, 3]
    return np.array([corners_m.min(axis=0), corners_m.max(axis=0)])


def drawn_load(press: ElasticPress, touches: int, *key: str | int) -> GelLoad:
    """Draw the loads of T touches of a round, which depend only on its key."""
    assert press.gel is not None
    shares = keyed_rng(*key, "press").random((touches, 4))
    far_m = _within(press.slide_m or _NONE, shares[:, 1])
    towards = np.array([arithmetic.cosine_sine(2 * np.pi * share) for share in shares[:, 2].tolist()])
    return GelLoad(
        press.force_n and _within(press.force_n, shares[:, 0]),
        press.press_m and _within(press.press_m, shares[:, 0]),
        far_m[:, None] * towards.reshape(-1, 2) + 0.0,  # not -0.0
        _within(press.twist_rad or _NONE, shares[:, 3]),
        press.gel,
    )


def _within(span: Span, shares: Float64) -> Float64:
    return span[0] + (span[1] - span[0]) * shares


def bare_plate_z_m(press: ElasticPress, sensor: sensors.Sensor) -> float:
    """Return the greatest height at which the sensor stops on the bare plate, metres."""
    assert press.gel is not None
    force_n, depth_m = (span and span[0] for span in (press.force_n, press.press_m))
    return plate_z_m(sensor, GelLoad(force_n, depth_m, gel=press.gel)) + _PLATE_MARGIN_M


def elastic_types(press: ElasticPress, size_px: tuple[int, int]) -> Mapping[str, pa.DataType]:
    """Return the types of the columns of an elastic gel, whose vectors have lengths of their own, by name."""
    number, half = pa.float32(), pa.float16()
    types: dict[str, pa.DataType] = {
        "extra.force_n": read.vectors_type(number, 3),
        "extra.torque_n_m": read.vectors_type(number, 3),
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
    press: ElasticPress,
    pressed: Pressed,
    motion: tuple[Float64, Float64],
    sensor: sensors.Sensor,
    size_px: tuple[int, int],
) -> dict[str, AnyArray]:
    """Return the attributes of a row of T touches of an elastic gel.

    ``motion`` is how far the object moved under the gel: slides (T, 2), metres, and turns (T,), radians.
    """
    contacts = pressed.contacts
    force_n = np.array([contact.force_n for contact in contacts])
    torque_n_m = np.array([contact.torque_n_m for contact in contacts])
    # Where the force of the press acts, from its moments about x and y.
    with np.errstate(invalid="ignore"):  # NaN without contact
        point_m = np.column_stack([-torque_n_m[:, 1], torque_n_m[:, 0]]) / force_n[:, 2:]
    numbers: dict[str, ArrayLike] = {
        "force_n": force_n,
        "torque_n_m": torque_n_m,
        "press_depth_m": np.array([contact.depth_m for contact in contacts]),
        "contact_point_m": point_m,
        "slide_m": motion[0],
        "twist_rad": motion[1],
    }
    values: dict[str, AnyArray] = {name: np.asarray(number, np.float32) for name, number in numbers.items()}
    if press.markers is not None:
        positions_px = markers_px(press.markers, pressed, sensor, size_px)
        flow_px = positions_px - marker_grid_px(press.markers, size_px)
        for name, pixels in (("marker_positions_px", positions_px), ("marker_flow_px", flow_px)):
            values[name] = pixels.reshape(len(contacts), -1).astype(np.float32)
    if press.contact_maps:
        pressure_kpa = [_averaged(contact.pressure_pa[..., None] / _KILO, size_px) for contact in contacts]
        moved_mm = [_averaged(contact.displacement_m / _MILLI, size_px) for contact in contacts]
        for name, maps in (("pressure_kpa", pressure_kpa), ("displacement_mm", moved_mm)):
            values[name] = np.array(maps, np.float16).reshape(len(contacts), -1)
    return values


def markers_px(
    markers: tuple[int, int], pressed: Pressed, sensor: sensors.Sensor, size_px: tuple[int, int]
) -> Float64:
    """Return the positions of the markers of T touches, shape (T, rows, columns, 2), pixels."""
    moved = [
        marker_positions_px(contact.displacement_m, sensor.window_m, markers, size_px)
        for contact in pressed.contacts
    ]
    return np.array(moved)


def _averaged(values: Float64, size_px: tuple[int, int]) -> Float32:
    """Return maps (H, W, k) in the size of the image: means over the area of each pixel."""
    if values.shape[1::-1] == size_px:
        return values.astype(np.float32)
    parts = np.moveaxis(values, -1, 0).astype(np.float32)
    scaled = [Image.fromarray(part).resize(size_px, Image.Resampling.BOX) for part in parts]
    return np.stack([np.asarray(part, np.float32) for part in scaled], axis=-1)
