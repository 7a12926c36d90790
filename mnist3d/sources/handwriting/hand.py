"""What stays the same in all digits of one writer."""

from __future__ import annotations

from dataclasses import dataclass

from mnist3d.sources.handwriting.dice import Dice

__all__ = ["Hand", "hand_of"]


@dataclass(frozen=True, slots=True)
class Hand:
    """The stable traits of a writer.

    Attributes
    ----------
    slant : float
        Sideways shift of the top per unit of height; positive leans right.
    tilt : float
        Rise of the writing line per unit of width.
    aspect : float
        Factor on the width of every glyph.
    bow : float
        How much verticals bend, as a share of the height.
    height_px, pen_px : float
        Ink height and pen width.
    nib : float
        0 for a round tip; 0.2 for a chisel tip whose stroke varies by 20 % with its direction.
    nib_lean : float
        Slope of the chisel's edge.
    pressure : float
        Relative change of the stroke width along a stroke.
    roundness : int
        Smoothing rounds on corners.
    jitter : float
        Size of the changes from digit to digit, relative to those between writers.
    tremor_px, roughness_px : float
        Deviation of the pen's path, and of the edge of the ink.
    gaps, specks : float
        Mean number of light flecks in the ink, and of stray dots beside it.
    fidelity : float
        Chance that a digit takes the writer's preferred shape.
    """

    slant: float
    tilt: float
    aspect: float
    bow: float
    height_px: float
    pen_px: float
    nib: float
    nib_lean: float
    pressure: float
    roundness: int
    jitter: float
    tremor_px: float
    roughness_px: float
    gaps: float
    specks: float
    fidelity: float


def hand_of(dice: Dice) -> Hand:
    """Draw a writer's traits.

    The ranges of height and pen width are those of HWD+ (Beaulac and Rosenthal 2022): ink 250 to 330 px
    tall, strokes 20 to 45 px wide.
    """
    return Hand(
        slant=0.13 + 0.165 * dice.bell(),
        tilt=0.03 * dice.bell(),
        aspect=1.14 + 0.105 * dice.bell(),
        bow=0.02 * dice.bell(),
        height_px=dice.uniform(258.0, 322.0),
        pen_px=min(42.0, max(22.0, 33.0 + 4.8 * dice.bell())),
        nib=max(0.0, dice.uniform(-0.15, 0.20)),
        nib_lean=dice.uniform(-1.0, 1.0),
        pressure=dice.uniform(0.02, 0.09),
        roundness=int(5.0 * dice.unit()),
        jitter=dice.uniform(0.3, 0.6),
        tremor_px=dice.uniform(0.3, 1.4),
        roughness_px=dice.uniform(0.5, 1.4),
        gaps=dice.uniform(0.0, 7.0),
        specks=dice.uniform(0.0, 4.0),
        fidelity=dice.uniform(0.86, 1.0),
    )
