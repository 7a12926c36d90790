"""What commands of touches, training sets and trainings have options of, imported with nothing heavy."""

from __future__ import annotations

import math
import tomllib
from collections.abc import Mapping
from dataclasses import asdict, dataclass, fields
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

from tactile_toolkit.builtin_values import to_builtin
from tactile_toolkit.checked_fields import check_fields, choice, integer, real, switch, text
from tactile_toolkit.errors import InputError
from tactile_toolkit.kind import lazy
from tactile_toolkit.touch import contact_height_option, size_option

if TYPE_CHECKING:
    from tactile_sim.noise import SensorNoise
    from tactile_sim.touch_table import TouchTable


POSITIONS = ("cell", "grid", "object", "given")

TURNS = {"digits": math.pi / 8, "any": math.pi, "none": 0.0}
"""Greatest turn of an object, radians: of the environments that classify, of all others, and none."""

_NOISE: Any = lazy("tactile_sim.noise:SensorNoise.named")

# A round is held in memory: at 320 x 240 these are 0.9 GB of pixels, and 2.5 of depth.
_MOST_TOUCHES = 4096
_MOST_ROUNDS = 1_000_000


WINDOWS = {"center": "environment", "full": "published"}
"""What of the sensor is seen, and how manifests name it."""


def _turn_rad(word: str) -> float:
    if word not in TURNS:
        raise InputError(f"--turn is {word!r}; expected one of {', '.join(TURNS)}")
    return TURNS[word]


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
        ``"object"``, uniform on the object as seen from above; ``"given"``, as ``given`` says.
    given : TouchTable, optional
        Where the gel goes with ``positions="given"``, and how the object lies, if it says so. Then
        ``touches`` is the most that a round of it has, and ``rounds`` is what it holds, if it numbers them.
    turn_rad : float
        Objects are turned about z by up to this much either way, radians; 0 leaves them as they are.
    object_placement : str
        ``"random"``: anywhere in the cell, a centimetre from its edge, as in the environments; ``"middle"``:
        the origin of the mesh in the middle of the cell.
    perturb : bool
        Move the object after each touch as the environments do: N(0, 1 mm) along x and y of its own frame,
        and N(0, 0.05 rad) about z.
    seed : int
        Seed of everything that is drawn.
    """

    rounds: int = integer(16, 1, _MOST_ROUNDS, help="Number of rounds of each object.")
    touches: int = integer(32, 1, _MOST_TOUCHES, help="Number of touches in a round.")
    positions: str = choice(
        "cell",
        POSITIONS,
        help="Where the gel goes: at random in the cell, on a grid, at random on the object, or as given "
        "by --touches-from.",
    )
    given: TouchTable | None = text(
        name="--touches-from",
        metavar="FILE",
        read=lazy("tactile_sim.touch_table:TouchTable.read"),
        help="Table of touches, CSV, Parquet or npz: x_m, y_m; object_id, round; object_x_m, object_y_m, "
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
        help="Random rotation of the object: up to 22.5 degrees, any angle, or none.",
    )
    object_placement: str = choice("random", ("random", "middle"))
    perturb: bool = switch(True, help="Move the object a little after each touch, as the environments do.")
    seed: int = integer(0, help="Random seed.")

    def __post_init__(self) -> None:
        given = self.given
        if (self.positions == "given") != hasattr(given, "longest"):
            held = "none" if given is None else type(given).__name__
            raise InputError(
                f"the plan of touches has positions {self.positions!r}, and its given touches are {held}; "
                "expected positions 'given' and a TouchTable, or neither",
                next="--positions given --touches-from FILE",
            )
        if given is not None:
            object.__setattr__(self, "touches", given.longest)
            object.__setattr__(self, "rounds", self.rounds if given.rounds is None else given.rounds)
        check_fields(self, "the plan of touches")

    def touches_of(self, object_id: int, number: int) -> int:
        """Return how many touches a round of an object has; 0 where a given plan does not name it."""
        return self.touches if self.given is None else len(self.given.of(object_id, number)[0])

    def to_dict(self) -> dict[str, Any]:
        """Return JSON values that decide every pose."""
        stored = {
            "positions": "place",
            "object_placement": "lie",
            "perturb": "shift",
        }  # as manifests name them
        found = {stored.get(each.name, each.name): getattr(self, each.name) for each in fields(self)}
        return {**found, "given": None if self.given is None else self.given.to_dict()}


# Five convolutions of 4 x 4, three of them halving, leave a patch of 2 x 2.
_LEAST_CROP_PX = 32


@dataclass(frozen=True)
class TrainConfig:
    """Settings of a training. The paper gives crops and nothing else; Zhu et al. 2017 means CycleGAN's paper.

    Attributes
    ----------
    filters, blocks : int
        Of the generators: those of the published weights.
    discriminator_filters : int
        Of the discriminators (Zhu et al. 2017).
    steps : int
        Optimiser steps; ours: ten passes over 20,000 pictures.
    pretrain_steps : int
        First steps, in which both directions also learn from pairs that simulation knows: depth, and the
        relief that Taxim shows of it, on what the real touches show of nothing (needs the extra ``sim``; 0
        does not). It has the weight of the cycles, which falls to 0; ours. Pictures that are not paired do
        not say where in them depth and relief belong together: these do.
    batch : int
        Pictures of each kind in a step and process (Zhu et al. 2017).
    crop : float
        Side of the random crops as a share of the picture; ours.
    learning_rate, first_moment : float
        Of Adam (Zhu et al. 2017); the second moment is 0.999.
    decay_from : float
        Share of the steps after which the learning rate falls linearly to 0 (Zhu et al. 2017).
    depth_cycle_weight, touch_cycle_weight, identity_weight : float
        Weights of the losses next to the adversarial one (Zhu et al. 2017: 10, 10 and 5). Most of a touch is
        background: where no relief is learned, weigh the cycle of touches more.
    background_weight : float
        Weight of what is known without pairs, if there are touches without contact: they have no depth, and
        where depth has no contact a touch looks as they do; ours. It keeps depth and relief in one place.
    sensor_noise : SensorNoise, optional
        Noise of the sensor that made the real touches, laid over made ones wherever networks are shown them;
        ours. A generator cannot make noise, and need not: ``generate --sensor-noise`` adds it to what it
        makes.
    noise : float
        White noise over all touches that the way back is shown, of values from -1 to 1: up to this standard
        deviation; ours. It keeps generators from hiding depth in invisible marks.
    discriminator_noise : float
        The same over all touches that discriminators are shown at first; it falls linearly to 0 until the
        learning rate begins to fall. Ours: they see coarse things first, and fine ones in the end.
    pool : int
        Made pictures that discriminators are shown again (Zhu et al. 2017).
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
        metavar="none|calibrated|FILE",
        shown="none",
        read=_NOISE,
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
        noise: Any = self.sensor_noise
        if noise is not None:
            from tactile_sim.noise import SensorNoise

            noise = SensorNoise(**noise) if isinstance(noise, dict) else noise  # as it was written
            object.__setattr__(self, "sensor_noise", noise)
        if not (noise is None or isinstance(noise, SensorNoise)):
            raise InputError(f"sensor_noise of the training is {noise!r}; expected a SensorNoise, or None")
        check_fields(self, "the training")

    @classmethod
    def read(cls, path: Path | None, given: Mapping[str, Any]) -> TrainConfig:
        """Read a TOML file with values of some fields; those ``given`` come before them.

        Raises
        ------
        InputError
            No such file, not TOML, an unknown field or a value that cannot be used.
        """
        try:
            held = {} if path is None else tomllib.loads(path.read_text(encoding="utf-8"))
        except (OSError, ValueError, RecursionError) as error:
            raise InputError(
                f"--config {str(path)!r} cannot be read ({error}); expected a TOML file"
            ) from error
        known = [each.name for each in fields(cls)]
        unknown = [name for name in held if name not in known]
        if unknown:
            raise InputError(
                f"--config {str(path)!r} has {unknown[0]!r}; expected some of {', '.join(known)}"
            )
        if isinstance(held.get("sensor_noise"), str):
            held["sensor_noise"] = _NOISE(held["sensor_noise"])
        return cls(**(held | dict(given)))

    def crop_px(self, size_px: tuple[int, int]) -> tuple[int, int]:
        """Return width and height of the crops, multiples of 4; InputError where they are too small."""
        width, height = (int(self.crop * side) // 4 * 4 for side in size_px)
        if min(width, height) < _LEAST_CROP_PX:
            raise InputError(
                f"crops of {width} x {height} pixels (crop {self.crop:g} of {size_px[0]} x {size_px[1]}) are "
                f"too small for the discriminators; expected at least {_LEAST_CROP_PX}",
                next="larger pictures, or a larger crop",
            )
        return width, height

    def rate(self, step: int) -> float:
        """Return the learning rate of a step, counted from 0."""
        start = self.decay_from * self.steps
        left = 1.0 if step < start else (self.steps - step) / max(self.steps - start, 1.0)
        return self.learning_rate * left

    def discriminator_noise_at(self, step: int) -> float:
        """Return the noise that discriminators are shown at a step, counted from 0."""
        return self.discriminator_noise * max(0.0, 1 - step / max(self.decay_from * self.steps, 1.0))

    def to_dict(self) -> dict[str, Any]:
        """Return JSON values."""
        return asdict(self)


SENSOR_NOISE = "none|calibrated|FILE"
"""What an option of the noise of a sensor takes."""


@dataclass(frozen=True, slots=True)
class PictureOptions:
    """What a touch looks like."""

    size: tuple[int, int] = size_option((64, 64), shown="64x64")
    optics: str | None = choice(
        None,
        ("depth", "taxim", "cyclegan"),
        optional=True,
        shown="taxim; depth without the extra sim",
        help="How an image is made from depth.",
    )
    window: str = choice(
        "center",
        tuple(WINDOWS),
        help="center: what the environments show in this size; full: the full view of the sensor, as in "
        "published sets.",
    )
    image_format: Literal["jpeg", "png"] = choice(
        "jpeg", ("jpeg", "png"), name="--format", help="Format of the images."
    )
    quality: int = integer(95, 1, 100, help="Quality of JPEGs, 1 to 100.")
    weights: Path | None = text(
        metavar="FILE",
        read=lazy("tactile_toolkit.store.files:expanded"),
        help="Weights for cyclegan; those of tactile-mnist by default.",
    )
    surface: str = choice(
        "smooth",
        ("smooth", "printed"),
        help="Surface of the objects: as modelled, or with the layers of a 3D print.",
    )
    layer_mm: float | None = real(
        None, 0.02, 2.0, optional=True, shown="0.2", help="Height of a layer with --surface printed."
    )
    sensor_noise: str = text(
        "none",
        metavar=SENSOR_NOISE,
        help="Noise of a real sensor on the images: none, as calibrated in tactile-mnist, or as in a JSON "
        "file.",
    )


def _metres(words: str) -> float:
    try:
        return float(words) / 1e3
    except ValueError:
        raise InputError(f"--min-height-mm is {words!r}; expected a number") from None


_SIDES_PX = range(16, 2049, 4)


@dataclass(frozen=True)
class PairsSpec:
    """Everything that decides a training set of learned rendering.

    Attributes
    ----------
    size_px : tuple of int
        Width and height of all pictures, pixels, multiples of 4; 256 x 256 as in the published weights.
    count : int
        Depth images, and as many real touches.
    without_contact : float
        Fraction of touches without contact, 0 to 1. The paper reduces it and does not say to how much.
    min_height_m : float or None
        A gel that stops so far above the plate touched an object, metres; None: the rule of the real touches,
        see :meth:`realtouch.touches.Touches.in_contact`, for both.
    window : str
        ``"full"``: depth of the full view of the sensor, squashed into the size as the real touches are;
        ``"center"``: the window that the environments show.
    image_format : str
        ``"png"`` or ``"jpeg"`` for the real touches; a network learns the blocks of a JPEG.
    turn_rad : float
        Objects are turned about z by up to this much either way, radians.
    seed : int
        Seed of everything that is drawn.
    """

    size_px: tuple[int, int] = size_option((256, 256), shown="256x256")
    count: int = integer(20_000, 1, 10_000_000, help="Number of depth images, and of real touches.")
    without_contact: float = real(
        0.05, 0, 1, metavar="SHARE", help="Fraction of touches without contact, 0 to 1."
    )
    min_height_m: float | None = contact_height_option(
        above=0, below=0.1, name="--min-height-mm", metavar="MM", read=_metres
    )
    window: str = choice(
        "full",
        tuple(WINDOWS),
        help="full: depth of the full view of the sensor, as real touches show it; center: as environments "
        "do.",
    )
    image_format: Literal["png", "jpeg"] = choice(
        "png", ("png", "jpeg"), name="--format", help="Format of the real touches."
    )
    turn_rad: float = real(math.pi / 8, 0, math.pi)
    seed: int = integer(0, help="Random seed.")

    def __post_init__(self) -> None:
        object.__setattr__(self, "size_px", to_builtin(self.size_px))
        check_fields(self, "the training set")
        if len(self.size_px) != 2 or not all(side in _SIDES_PX for side in self.size_px):
            raise InputError(
                f"size_px of the training set is {self.size_px}; expected multiples of 4 from 16 to 2048"
            )

    def is_empty(self, number: int) -> bool:
        """Return whether a touch meets no object: evenly spread, so that every shard has its share."""
        return int((number + 1) * self.without_contact) > int(number * self.without_contact)

    def to_dict(self) -> dict[str, Any]:
        """Return JSON values that decide every row."""
        values = asdict(self)
        return {**values, "like": WINDOWS[values.pop("window")]}
