"""The public names of this package; type checkers read this list, and each name is imported on first use."""

from .drawn_records import (
    Drawn as Drawn,
    figure_html as figure_html,
    grid_html as grid_html,
    png_bytes as png_bytes,
)
from .previews import (
    ChosenRows as ChosenRows,
    PicturePlan as PicturePlan,
    PlannedPicture as PlannedPicture,
    file_stem as file_stem,
    plan_sheets as plan_sheets,
)
from .sheets import (
    ACCENTS as ACCENTS,
    INK as INK,
    PAPER as PAPER,
    Tile as Tile,
    bar_length_mm as bar_length_mm,
    draw_text as draw_text,
    fitted as fitted,
    sheet as sheet,
    text_size as text_size,
    with_scale_bar as with_scale_bar,
)
from .solid_views import (
    DrawnBody as DrawnBody,
    DrawnSolid as DrawnSolid,
    View as View,
    draw_mesh as draw_mesh,
    relief as relief,
    solid_sheet as solid_sheet,
)
