"""How streams are aligned to the pictures of a recording, imported with nothing heavy."""

from __future__ import annotations

from dataclasses import dataclass

from tactile_toolkit.checked_fields import check_fields, choice, real

ALIGN_METHODS = ("nearest", "linear")


@dataclass(frozen=True, slots=True)
class Alignment:
    """How streams of other rates are aligned to the times of pictures.

    Attributes
    ----------
    method : "nearest" or "linear"
        Which value a picture gets: that of the nearest sample, the earlier of two equally near; or one on a
        line between the two samples around it, of quaternions on the shorter turn, and of columns whose names
        state degrees or radians on the shorter way around the circle. Text, integers and switches are always
        those of the nearest sample.
    max_gap_ms : float
        A picture gets a missing value if its nearest sample is farther away than this, or if it lies between
        two samples that are farther apart, milliseconds.
    time_offset_s : float
        Added to the times of all streams, seconds.
    """

    method: str = choice(
        "nearest",
        ALIGN_METHODS,
        name="--align",
        help="Value of a picture from a stream of another rate: the nearest sample, or between two.",
    )
    max_gap_ms: float = real(
        100.0,
        above=0,
        metavar="MS",
        help="Longest gap of a stream in which pictures get values.",
    )
    time_offset_s: float = real(
        0.0, -1e12, 1e12, metavar="S", help="Added to the times of streams, where their clock is another one."
    )

    def __post_init__(self) -> None:
        check_fields(self, "the alignment")
