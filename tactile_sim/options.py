"""Touches and training sets as commands have options of them: lengths in millimetres, files by name."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Literal

from tactile_sim.spec import TouchPlan
from tactile_toolkit.checked_fields import choice, integer, real, text
from tactile_toolkit.errors import InputError
from tactile_toolkit.touch.contact import contact_height_option, size_option

if TYPE_CHECKING:
    from tactile_sim.generation import GenerateSpec
    from tactile_sim.pairs.making import PairsSpec


SENSOR_NOISE = "none|calibrated|FILE"
"""What an option of the noise of a sensor takes."""


def _path(words: str) -> Path:
    from tactile_toolkit.store.files import expanded

    return expanded(words)


@dataclass(frozen=True, slots=True)
class PictureOptions:
    """What a touch looks like."""

    size: tuple[int, int] = size_option((64, 64), shown="64x64")
    optics: str = choice("taxim", ("depth", "taxim", "cyclegan"), help="How depth becomes a picture.")
    like: str = choice(
        "environment",
        ("environment", "published"),
        help="environment: rendered in this size, with the window that the environments show; published: "
        "rendered as 320x240 of the whole sensor and scaled.",
    )
    image_format: Literal["jpeg", "png"] = choice(
        "jpeg", ("jpeg", "png"), name="--format", help="Format of the pictures."
    )
    quality: int = integer(95, 1, 100, help="Quality of JPEGs, 1 to 100.")
    weights: Path | None = text(
        metavar="FILE", read=_path, help="Weights for cyclegan; those of tactile-mnist by default."
    )
    surface: str = choice(
        "smooth",
        ("smooth", "printed"),
        help="Solids as they are modelled, or with the layers that a printer lays.",
    )
    layer_mm: float | None = real(
        None, 0.02, 2.0, optional=True, shown="0.2", help="Height of the layers with --surface printed."
    )
    sensor_noise: str = text(
        "none",
        metavar=SENSOR_NOISE,
        help="Noise of a real sensor on the pictures: none, as calibrated in tactile-mnist, or as in a JSON "
        "file.",
    )

    def spec(self, plan: TouchPlan | None = None, limit: int | None = None) -> GenerateSpec:
        """Return the specification of touches."""
        from tactile_sim.generation import GenerateSpec, require_pictures
        from tactile_sim.noise import SensorNoise

        if self.layer_mm is not None and self.surface != "printed":
            raise InputError("--layer-mm is about printed solids", next="add --surface printed")
        if self.sensor_noise != "none":
            require_pictures(self.optics)  # before a package is asked for that would not help
        return GenerateSpec(
            self.size,
            self.optics,
            self.like,
            TouchPlan() if plan is None else plan,
            self.image_format,
            self.quality,
            None if self.weights is None else str(self.weights),
            limit,
            (0.2 if self.layer_mm is None else self.layer_mm) / 1000 if self.surface == "printed" else 0.0,
            SensorNoise.named(self.sensor_noise),
        )


@dataclass(frozen=True, slots=True)
class PairsOptions:
    """What a training set is made of."""

    size: tuple[int, int] = size_option((256, 256), shown="256x256")
    count: int = integer(20_000, 1, help="Depth images, and as many touches.")
    without_contact: float = real(
        0.05, 0, 1, metavar="SHARE", help="Share of touches that meet no object, 0 to 1."
    )
    min_height_mm: float | None = contact_height_option()
    like: Literal["published", "environment"] = choice(
        "published",
        ("published", "environment"),
        help="Depth of the whole sensor, as real touches show it, or of an environment's window.",
    )
    image_format: Literal["png", "jpeg"] = choice(
        "png", ("png", "jpeg"), name="--format", help="Format of the real touches."
    )
    seed: int = integer(0, help="Seed of everything that is drawn at random.")

    def spec(self) -> PairsSpec:
        """Return the specification of a training set. Raises InputError for what cannot be used."""
        from tactile_sim.pairs.making import PairsSpec

        height_mm = self.min_height_mm
        return PairsSpec(
            self.size,
            self.count,
            self.without_contact,
            None if height_mm is None else height_mm / 1e3,
            self.like,
            self.image_format,
            seed=self.seed,
        )
