"""The public names of this package; type checkers read this list, and each name is imported on first use."""

from .allographs import ALLOGRAPHS as ALLOGRAPHS
from .inking import ink_paths as ink_paths
from .keyed_random import KeyedRng as KeyedRng
from .page_layout import on_page as on_page
from .writer_style import (
    DIGIT_STYLES as DIGIT_STYLES,
    WriterStyle as WriterStyle,
    choose_allograph as choose_allograph,
    draw_style as draw_style,
    style_for_digit as style_for_digit,
    variation as variation,
)
