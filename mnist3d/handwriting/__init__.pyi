"""The public names of this package; type checkers read this list, and each name is imported on first use."""

from .allographs import ALLOGRAPHS as ALLOGRAPHS
from .writers import (
    choose_allograph as choose_allograph,
    DIGIT_STYLES as DIGIT_STYLES,
    draw_style as draw_style,
    KeyedRng as KeyedRng,
    style_for_digit as style_for_digit,
    variation as variation,
    WriterStyle as WriterStyle,
)
