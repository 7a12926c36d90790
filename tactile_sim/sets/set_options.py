"""Options of simulated data sets and of trainings.

This module is imported by commands for their options, and imports nothing heavy.
"""

from __future__ import annotations

import math
import tomllib
from collections.abc import Sequence
from dataclasses import asdict, dataclass, field, fields
from functools import partial
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING, Literal

from tactile_sim.press.press_spec import ElasticPress
from tactile_sim.press.sensors import GELSIGHT_MINI, OPTICS, SENSORS, SensorModel, checked_sensor
from tactile_toolkit import checked_fields, store, touch
from tactile_toolkit.checked_fields import check_fields, choice, integer, real, switch, text
from tactile_toolkit.errors import InputError, IntegrityError
from tactile_toolkit.kind import lazy
from tactile_toolkit.value_types import JsonDict, JsonObject

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
_SIDES_PX = range(16, 2049, 4)

# Five convolutions of 4 x 4, three of them halving, leave a patch of 2 x 2.
_MIN_CROP_PX = 32


def default_optics() -> str:
    """Return the optics of commands: Taxim where the extra `sim` is installed, otherwise depth."""
    return "depth" if find_spec("taxim") is None else "taxim"


def _turn_rad(word: str) -> float:
    if word not in TURNS:
        raise InputError(f"is {word!r}; expected one of {', '.join(TURNS)}", field="turn_rad")
    return TURNS[word]


def _metres(name: str, words: str) -> float:
    """Return millimetres of an option as metres; ``name`` is the field."""
    try:
        return float(words) / 1e3
    except ValueError:
        raise InputError(f"is {words!r}; expected a number", field=name) from None


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

    size_px: tuple[int, int] = touch.size_option((64, 64), shown="64x64")
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
        read=partial(_metres, "layer_m"),
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
        is_full = self.window == "full"
        width, height = (self.sensor.width_px, self.sensor.height_px) if is_full else self.size_px
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
            "noise": None if self.noise is None else self.noise.to_dict(),
            **sensor,
            **self.chosen,
        }


@dataclass(frozen=True)
class PairSetSpec:
    """Everything that decides a training set of learned rendering.

    Attributes
    ----------
    size_px : tuple of int
        Width and height of all images, pixels, multiples of 4; 256 x 256 as in the published weights.
    count : int
        Number of depth images, and of real touches.
    without_contact : float
        Fraction of touches without contact, 0 to 1. The paper reduces it and does not state to how much.
    min_height_m : float or None
        Height above the plate, metres, from which a touch counts as contact; None for the rule of the real
        touches, see :meth:`realtouch.touches.datasets.Touches.in_contact`.
    window : str
        ``"full"``: depth of the full view of the sensor, squashed into the size like the real touches;
        ``"center"``: the window that the environments show.
    image_format : str
        ``"png"`` or ``"jpeg"`` for the real touches; a network learns the blocks of a JPEG.
    turn_rad : float
        Objects are rotated about z by at most this angle either way, radians.
    seed : int
        Seed of everything that is drawn.
    """

    size_px: tuple[int, int] = touch.size_option((256, 256), shown="256x256")
    count: int = integer(20_000, 1, 10_000_000, help="Number of depth images, and of real touches.")
    without_contact: float = real(
        0.05, 0, 1, metavar="SHARE", help="Fraction of touches without contact, 0 to 1."
    )
    min_height_m: float | None = touch.HeightRule.option(
        above=0, below=0.1, name="--min-height-mm", metavar="MM", read=partial(_metres, "min_height_m")
    )
    window: str = choice(
        "full",
        tuple(WINDOWS),
        help="full: depth of the full view of the sensor, as real touches show it; center: as environments "
        "do.",
    )
    image_format: Literal["png", "jpeg"] = choice("png", ("png", "jpeg"), help="Format of the real touches.")
    turn_rad: float = real(math.pi / 8, 0, math.pi)
    seed: int = integer(0, help="Random seed.")

    def __post_init__(self) -> None:
        object.__setattr__(self, "size_px", checked_fields.to_builtin(self.size_px))
        check_fields(self, "the training set")
        is_pair = isinstance(self.size_px, tuple) and len(self.size_px) == 2
        if not is_pair or not all(isinstance(side, int) and side in _SIDES_PX for side in self.size_px):
            raise InputError(
                f"of the training set is {self.size_px}; expected multiples of 4 from 16 to 2048",
                field="size_px",
            )

    def is_empty(self, number: int) -> bool:
        """Return whether a touch has no contact; these are spread evenly over the shards."""
        return int((number + 1) * self.without_contact) > int(number * self.without_contact)

    def to_dict(self) -> JsonDict:
        """Return JSON values that decide every row."""
        values = asdict(self)
        return {**values, "like": WINDOWS[values.pop("window")]}


@dataclass(frozen=True)
class TrainConfig:
    """Settings of a training.

    The paper states crops and nothing else. Defaults are those of CycleGAN (Zhu et al. 2017) where that is
    named, and the toolkit's own where it says "ours".

    Attributes
    ----------
    filters, blocks : int
        Filters of the first layer, and residual blocks, of the generators: those of the published weights.
    discriminator_filters : int
        Filters of the first layer of the discriminators (Zhu et al. 2017).
    steps : int
        Optimiser steps; ours: ten passes over 20,000 images.
    pretrain_steps : int
        First steps, in which both directions also learn from simulated pairs: depth, and the relief that
        Taxim renders of it on the background of the real touches (needs the extra ``sim``; 0 needs none).
        The loss has the weight of the cycles, which falls to 0; ours. Unpaired images do not show where in
        them depth and relief belong together; these do.
    batch : int
        Images of each kind in a step and process (Zhu et al. 2017).
    crop : float
        Side of the random crops as a share of the image; ours.
    learning_rate, first_moment : float
        Parameters of Adam (Zhu et al. 2017); the second moment is 0.999.
    decay_from : float
        Share of the steps after which the learning rate falls linearly to 0 (Zhu et al. 2017).
    depth_cycle_weight, touch_cycle_weight, identity_weight : float
        Weights of the losses relative to the adversarial one (Zhu et al. 2017: 10, 10 and 5). Most of a touch
        is background: where no relief is learned, raise the weight of the cycle of touches.
    background_weight : float
        Weight of two facts that need no pairs, if there are touches without contact: these have no depth, and
        where depth shows no contact, a touch looks like them; ours. It keeps depth and relief in one place.
    sensor_noise : SensorNoise, optional
        Noise of the sensor that made the real touches, added to generated ones wherever networks see them;
        not in the paper. A generator cannot make noise; ``generate --sensor-noise`` adds it to its images.
    noise : float
        Greatest standard deviation of white noise on all touches from which depth is generated, for values
        from -1 to 1; not in the paper. It keeps generators from hiding depth in invisible patterns.
    discriminator_noise : float
        Initial standard deviation of white noise on all touches that discriminators see; it falls linearly to
        0 until the learning rate begins to fall. Not in the paper: coarse structure is learned first.
    pool : int
        Number of earlier generated images that discriminators see again (Zhu et al. 2017).
    seed : int
        Seed of weights, order, crops and pools.
    checkpoint_every, log_every : int
        Steps between checkpoints, and between lines of the log; ours.
    """

    filters: int = integer(64, 1, 1024, help="Number of filters of the generators.")
    blocks: int = integer(9, 0, 64, help="Number of residual blocks.")
    discriminator_filters: int = integer(64, 1, 1024)
    steps: int = integer(200_000, 1, 10**9, help="Total number of steps.")
    pretrain_steps: int = integer(2500, 0, 10**9)
    batch: int = integer(1, 1, 4096, help="Images of each kind in a step.")
    crop: float = real(0.875, 0.1, 1)
    learning_rate: float = real(2e-4, 1e-8, 1, help="Learning rate of Adam.")
    first_moment: float = real(0.5, 0, 0.999)
    decay_from: float = real(0.5, 0, 1)
    depth_cycle_weight: float = real(10.0, 0, 1e4)
    touch_cycle_weight: float = real(10.0, 0, 1e4)
    identity_weight: float = real(5.0, 0, 1e4)
    background_weight: float = real(10.0, 0, 1e4)
    sensor_noise: SensorNoise | None = text(
        metavar=SENSOR_NOISE,
        shown="none",
        read=_named_noise,
        help="Sensor noise that is added to generated images during training: as for `generate "
        "--sensor-noise`.",
    )
    noise: float = real(0.0, 0, 1)
    discriminator_noise: float = real(0.0, 0, 1)
    pool: int = integer(50, 0, 10_000)
    seed: int = integer(0, 0, 2**63, help="Random seed.")
    checkpoint_every: int = integer(1000, 1, 10**9)
    log_every: int = integer(50, 1, 10**9)

    def __post_init__(self) -> None:
        object.__setattr__(self, "sensor_noise", _checked_noise(self.sensor_noise, "sensor_noise"))
        check_fields(self, "the training")

    @classmethod
    def read(cls, path: Path | None, overrides: JsonObject) -> TrainConfig:
        """Read a TOML file with values of some fields; those ``given`` override them.

        Raises
        ------
        InputError
            The file does not exist, is not TOML, or has an unknown field or a value that cannot be used.
        """
        if path is None:
            return cls(**overrides)
        try:
            with store.open_regular(path) as stream:
                held = tomllib.load(stream)
        except (OSError, ValueError, RecursionError, IntegrityError) as error:
            raise InputError(
                f"{str(path)!r} cannot be read ({error}); expected a TOML file", field="config"
            ) from error
        known = [field.name for field in fields(cls)]
        unknown = [name for name in held if name not in known]
        if unknown:
            raise InputError(
                f"{str(path)!r} has {unknown[0]!r}; expected some of {', '.join(known)}", field="config"
            )
        if isinstance(held.get("sensor_noise"), str):
            held["sensor_noise"] = _named_noise(held["sensor_noise"])
        return cls(**(held | dict(overrides)))

    def crop_px(self, size_px: tuple[int, int]) -> tuple[int, int]:
        """Return width and height of the crops, multiples of 4; InputError if they are too small."""
        width, height = (int(self.crop * side) // 4 * 4 for side in size_px)
        if min(width, height) < _MIN_CROP_PX:
            raise InputError(
                f"crops of {width} x {height} pixels (crop {self.crop:g} of {size_px[0]} x {size_px[1]}) are "
                f"too small for the discriminators; expected at least {_MIN_CROP_PX}",
                next="larger images, or a larger crop",
            )
        return width, height

    def rate(self, step: int) -> float:
        """Return the learning rate of a step, counted from 0."""
        start = self.decay_from * self.steps
        if step < start:
            return self.learning_rate
        return self.learning_rate * ((self.steps - step) / max(self.steps - start, 1.0))

    def discriminator_noise_at(self, step: int) -> float:
        """Return the noise that discriminators see at a step, counted from 0."""
        return self.discriminator_noise * max(0.0, 1 - step / max(self.decay_from * self.steps, 1.0))

    def to_dict(self) -> JsonDict:
        """Return JSON values."""
        return asdict(self)


@dataclass(frozen=True)
class TrainRun:
    """How a training is computed, which does not decide its settings.

    Attributes
    ----------
    device : str
        ``"cpu"``, ``"cuda"``, or ``"auto"`` for a GPU if there is one. Under ``torchrun`` each process takes
        a GPU of its own.
    deterministic : bool
        Train on one thread of the CPU: every run on one machine gives the same weights, interrupted or not.
        Refused on a GPU.
    resume : bool
        Raise an error if the folder holds no training to continue.
    compiled : bool
        Compile the generators first, for GPUs.
    """

    device: str = choice("auto", ("auto", "cpu", "cuda"), help="Where to compute.")
    deterministic: bool = switch(False, help="Compute on the CPU so that every run gives the same weights.")
    resume: bool = switch(False, help="Continue the training in the folder; an error if there is none.")
    compiled: bool = switch(False, name="--compile", help="Compile the generators first, for GPUs.")

    def __post_init__(self) -> None:
        check_fields(self, "the training")
