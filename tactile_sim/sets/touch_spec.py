"""Specifications of data sets of touches: where the gel goes, and what a touch looks like.

This module is imported by commands for their options, and imports nothing heavy.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field, fields
from importlib.util import find_spec
from typing import TYPE_CHECKING, Literal

from tactile_sim.press.press_spec import ElasticPress
from tactile_sim.press.sensors import GELSIGHT_MINI, OPTICS, SENSORS, SensorModel, checked_sensor
from tactile_toolkit.checked_fields import check_fields, choice, integer, real, switch, text
from tactile_toolkit.errors import InputError
from tactile_toolkit.kind import lazy
from tactile_toolkit.touch import size_option
from tactile_toolkit.value_types import JsonDict

if TYPE_CHECKING:
    from tactile_sim.optics.sensor_noise import SensorNoise
    from tactile_sim.sets.touch_table import TouchTable
    from tactile_toolkit.catalog import IdChoice


WINDOWS = {"center": "environment", "full": "published"}
"""Windows of the gel that an image shows, and how manifests name them."""
POSITIONS = ("cell", "grid", "object", "given")
"""Ways of choosing where the gel goes."""
TURNS = {"digits": math.pi / 8, "any": math.pi, "none": 0.0}
"""Greatest rotation of an object, radians: in the environments that classify, in all others, and none."""
SENSOR_NOISE = "none|calibrated|STD|FILE"
"""Values of the options for the noise of a sensor."""

# A round is held in memory: at 320 x 240 pixels these are 0.9 GB of images and 2.5 GB of depth.
_MAX_TOUCHES = 4096
_MAX_PIXELS = _MAX_TOUCHES * 320 * 240

# For an elastic gel, these are 2 GB of pressure, traction and displacement.
_MAX_ELASTIC_PIXELS = _MAX_PIXELS // 8
_MAX_ROUNDS = 1_000_000
_STORED_NAMES = {  # in manifests
    "positions": "place",
    "touch_table": "given",
    "object_placement": "lie",
    "perturb": "shift",
}
_checked_size_px = lazy("tactile_sim.press.sensors:checked_size_px")
_checked_layer_m = lazy("tactile_sim.press.pressable:checked_layer_m")
_checked_noise = lazy("tactile_sim.optics.sensor_noise:checked_noise")
_calibrated_noise = lazy("tactile_sim.optics.sensor_noise:SensorNoise.calibrated")
_named_noise = lazy("tactile_sim.optics.sensor_noise:SensorNoise.named")
_weights_facts = lazy("tactile_sim.learned.generators:weights_facts")


def default_optics() -> str:
    """Return the optics of commands: Taxim where the extra `sim` is installed, otherwise depth."""
    return "depth" if find_spec("taxim") is None else "taxim"


def _turn_rad(word: str) -> float:
    if word not in TURNS:
        raise InputError(f"is {word!r}; expected one of {', '.join(TURNS)}", field="turn_rad")
    return TURNS[word]


def _layer_m(words: str) -> float:
    try:
        layer_m = float(words) / 1e3
    except ValueError:
        raise InputError(f"is {words!r}; expected a number", field="layer_m") from None
    checked: float = _checked_layer_m(layer_m)
    return checked


@dataclass(frozen=True)
class TouchPlan:
    """How often and where each object is touched.

    Attributes
    ----------
    rounds : int
        Rounds of each object; it is placed again in each.
    touches : int
        Number of touches in a round.
    positions : str
        Where the gel goes: ``"cell"``, uniform in what it reaches; ``"grid"``, rows from the front left;
        ``"object"``, uniform on the object as seen from above; ``"given"``, as in ``touch_table``.
    touch_table : TouchTable, optional
        Where the gel goes with ``positions="given"``, and how the object lies, if the table has such columns.
        Then ``touches`` is the longest round of the table, and ``rounds`` their number, if it numbers them.
    turn_rad : float
        Greatest random rotation of objects about z in either direction, radians.
    object_placement : str
        ``"random"``: anywhere in the cell, a centimetre from its edge, as in the environments; ``"middle"``:
        the origin of the mesh in the middle of the cell.
    perturb : bool
        Move the object after each touch as the environments do: N(0, 1 mm) along x and y of its own frame,
        and N(0, 0.05 rad) about z.
    seed : int
        Seed of all random numbers.
    """

    rounds: int = integer(
        16, 1, _MAX_ROUNDS, panel="Plan of the touches", help="Number of rounds of each object."
    )
    touches: int = integer(
        32, 1, _MAX_TOUCHES, panel="Plan of the touches", help="Number of touches in a round."
    )
    positions: str = choice(
        "cell",
        POSITIONS,
        panel="Plan of the touches",
        help="Positions of the gel: at random in the cell, on a grid, at random on the object, or given "
        "by --touches-from.",
    )
    touch_table: TouchTable | None = text(
        name="--touches-from",
        metavar="FILE",
        read=lazy("tactile_sim.sets.touch_table:TouchTable.read"),
        panel="Plan of the touches",
        help="Table of touches, CSV or Parquet: x_m, y_m; object_id, round; object_x_m, object_y_m, "
        "object_turn_rad.",
    )
    turn_rad: float = real(
        math.pi / 8,
        0,
        math.pi,
        name="--turn",
        metavar="digits|any|none",
        shown="digits",
        read=_turn_rad,
        panel="Plan of the touches",
        help="Random rotation of the object: up to 22.5 degrees, any angle, or none.",
    )
    object_placement: str = choice("random", ("random", "middle"))
    perturb: bool = switch(
        True,
        panel="Plan of the touches",
        help="Move the object a little after each touch, as the environments do.",
    )
    seed: int = integer(0, panel="Plan of the touches", help="Random seed.")

    def __post_init__(self) -> None:
        table = self.touch_table
        # Not by `isinstance`: importing TouchTable is heavy, and commands import this module.
        is_given = isinstance(self.positions, str) and self.positions == "given"
        is_table = hasattr(table, "longest")
        if is_given != is_table or is_table != (table is not None):
            kind = type(table).__name__.replace("NoneType", "none")
            raise InputError(
                f"the plan of touches has positions {self.positions!r}, and its given touches are {kind}; "
                "expected positions 'given' and a TouchTable, or neither",
                next="give --positions given --touches-from FILE",
            )
        if table is not None:
            object.__setattr__(self, "touches", table.longest)
            object.__setattr__(self, "rounds", table.rounds or self.rounds)
        check_fields(self, "the plan of touches")

    def touches_of(self, object_id: int, number: int) -> int:
        """Return the number of touches in a round of an object; 0 if a given plan does not contain it."""
        if self.touch_table is None:
            return self.touches
        return len(self.touch_table.of(object_id, number)[0])

    def to_dict(self) -> JsonDict:
        """Return JSON values that decide every pose."""
        names = [declared.name for declared in fields(self)]
        values = {_STORED_NAMES.get(name, name): getattr(self, name) for name in names}
        if self.touch_table is not None:
            values["given"] = self.touch_table.to_dict()
        return values


@dataclass(frozen=True)
class TouchSetSpec:
    """Everything that decides the touches of a set of solids.

    Attributes
    ----------
    size_px : tuple of int
        Width and height of the images, pixels.
    optics : str
        How depth becomes an image: ``"depth"``, ``"taxim"``, ``"cyclegan"``, or ``"twin"`` for a calibrated
        sensor.
    window : str
        ``"center"``: rendered in this size, with the window that the environments show in it;
        ``"full"``: rendered as 320 x 240 pixels of the full view of the sensor and scaled to the size.
    plan : TouchPlan
        Where the gel goes.
    image_format : str
        ``"jpeg"`` or ``"png"``.
    quality : int
        Quality of JPEGs, 1 to 100.
    weights : str or None
        File of weights for ``"cyclegan"``; the published ones by default.
    limit : int or None
        Only the first ``limit`` objects of each split.
    layer_m : float
        Height of the layers in which the solids are printed, metres; 0 for solids as they are modelled.
    noise : SensorNoise or None
        Noise of a real sensor, drawn for each set, object, round and touch, and added last, to the image in
        its final size. In depth images it is a fraction of their range, half of the gel; the calibrated one,
        which is that of a camera, is not for them.
    sensor : SensorModel
        Geometry of the sensor, or the name of one of :data:`tactile_sim.SENSORS`; a GelSight Mini by default.
        Others have depth images: Taxim and the generators are calibrated for the Mini. ``"center"`` is then
        the largest part of their sensing area with square pixels, and ``"full"`` all of it, rendered in their
        own pixels and scaled.
    press : ElasticPress or None
        Presses of an elastic gel; None for a gel that is pressed to one depth and shows the undeformed solid.
    ids, labels, per_class : optional
        Only objects with these ids (a pair stands for all from its first to its last), of these classes, and
        of these the first ``per_class`` of each class of a split; then ``limit``.
    """

    size_px: tuple[int, int] = size_option((64, 64), shown="64x64")
    optics: str = choice(
        "taxim",
        OPTICS,
        shown="taxim; depth without the extra sim",
        panel="Images",
        help="How an image is made from depth.",
    )
    window: str = choice(
        "center",
        tuple(WINDOWS),
        panel="Images",
        help="center: what the environments show in this size; full: the full view of the sensor, as in "
        "published sets.",
    )
    plan: TouchPlan = field(default_factory=TouchPlan)
    image_format: Literal["jpeg", "png"] = choice(
        "jpeg", ("jpeg", "png"), panel="Images", help="Format of the images."
    )
    quality: int = integer(
        95, 1, 100, needs="image_format=jpeg", panel="Images", help="Quality of JPEGs, 1 to 100."
    )
    weights: str | None = text(
        metavar="FILE",
        read=str,
        needs="optics=cyclegan",
        panel="Images",
        help="Weights for cyclegan; those of tactile-mnist by default.",
    )
    limit: int | None = integer(None, 1, optional=True)
    layer_m: float = real(
        0.0,
        name="--layer-mm",
        metavar="MM",
        shown="0, smooth",
        read=_layer_m,
        panel="Images",
        help="Render a printed surface with layers of this height.",
    )
    noise: SensorNoise | None = text(
        name="--sensor-noise",
        metavar=SENSOR_NOISE,
        shown="none",
        read=_named_noise,
        panel="Images",
        help="Noise on the images: none, as calibrated in tactile-mnist, Gaussian of this standard deviation "
        "(fraction of the range of an image), or as in a JSON file.",
    )
    sensor: SensorModel = text(
        GELSIGHT_MINI,
        metavar=f"{'|'.join(SENSORS)}|FILE|DIR",
        shown=GELSIGHT_MINI.name,
        read=SensorModel.named,
        panel="Images",
        help="Name of a sensor, a JSON file, or a folder that `tactile-sim calibrate` wrote. Sensors other "
        "than the Mini need --optics depth unless they were calibrated.",
    )
    press: ElasticPress | None = None
    ids: IdChoice | None = None
    labels: Sequence[str] | None = None
    per_class: int | None = integer(None, 1, optional=True)

    def __post_init__(self) -> None:
        object.__setattr__(self, "size_px", _checked_size_px(self.size_px))
        object.__setattr__(self, "layer_m", _checked_layer_m(self.layer_m))
        check_fields(self, "the touches")
        object.__setattr__(self, "noise", _checked_noise(self.noise, "noise"))
        if self.noise is not None and self.optics == "depth" and self.noise == _calibrated_noise():
            raise InputError(
                "the optics 'depth' do not have the calibrated noise: it is that of a camera's images",
                next="add --optics taxim, or give the standard deviation of another noise, such as 0.005",
            )
        object.__setattr__(self, "sensor", checked_sensor(self.sensor))
        self.sensor.require_optics(self.optics)
        self._check_press()
        if not self.has_other_sensor:
            return
        most = _MAX_PIXELS // (self.sensor.width_px * self.sensor.height_px)
        if self.plan.touches > most:
            raise InputError(
                f"the plan has {self.plan.touches:,} touches in a round; expected at most {most:,} in the "
                f"pixels of the sensor {self.sensor.name!r}",
                next="divide them into several rounds",
            )

    def _check_press(self) -> None:
        """Refuse rounds of an elastic gel whose maps would not fit into memory (InputError)."""
        if self.press is None:
            return
        if not isinstance(self.press, ElasticPress):
            raise InputError(f"press of the touches is {self.press!r}; expected an ElasticPress, or None")
        press_m = self.press.press_m
        gel_m = self.sensor.gel_mm / 1e3
        if press_m is not None and not press_m[1] < gel_m:
            raise InputError(
                f"the press is {press_m[1]:g} m deep; expected less than the gel is thick, {gel_m:g} m",
                next="give a smaller depth (--press-mm)",
            )
        width, height = self.size_px
        if self.window == "full":
            width = self.sensor.width_px
            height = self.sensor.height_px
        most = _MAX_ELASTIC_PIXELS // (width * height)
        if self.plan.touches > most:
            raise InputError(
                f"the plan has {self.plan.touches:,} touches in a round; expected at most {most:,} with an "
                f"elastic gel of {width} x {height} pixels",
                next="divide them into several rounds",
            )

    @property
    def has_other_sensor(self) -> bool:
        """Whether the sensor is not the GelSight Mini."""
        return self.sensor != GELSIGHT_MINI

    @property
    def chosen(self) -> JsonDict:
        """Restrictions to some of the objects, by name; empty if all are touched."""
        named = {"ids": self.ids, "labels": self.labels, "per_class": self.per_class}
        return {name: value for name, value in named.items() if value is not None}

    def to_dict(self) -> JsonDict:
        """Return JSON values that decide the images and poses."""
        # By content: the same weights under another name give the same images.
        network: JsonDict = {"weights_sha256": None}
        if self.optics == "cyclegan":
            network = _weights_facts(self.weights)
        noise = None
        if self.noise is not None:
            noise = self.noise.to_dict()
        sensor: JsonDict = {}
        if self.has_other_sensor:
            sensor = {"sensor": self.sensor.to_dict()}
        if self.press is not None:
            sensor["press"] = self.press.to_dict()
        return {
            "size_px": list(self.size_px),
            "optics": self.optics,
            "like": WINDOWS[self.window],
            "plan": self.plan.to_dict(),
            "image_format": self.image_format,
            "quality": self.quality if self.image_format == "jpeg" else None,
            **network,
            "limit": self.limit,
            "layer_m": self.layer_m,
            "noise": noise,
            **sensor,
            **self.chosen,
        }
