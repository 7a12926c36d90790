"""The public names of this package; type checkers read this list, and each name is imported on first use."""

from .sheets import (
    ACCENTS as ACCENTS,
    bar_length_mm as bar_length_mm,
    Drawn as Drawn,
    figure_html as figure_html,
    fitted as fitted,
    INK as INK,
    PAPER as PAPER,
    Pen as Pen,
    png_bytes as png_bytes,
    sheet as sheet,
    Tile as Tile,
)
from .previews import (
    ChosenRows as ChosenRows,
    PicturePlan as PicturePlan,
    PlannedPicture as PlannedPicture,
    plan_sheets as plan_sheets,
)
from .solid_views import (
    DrawnBody as DrawnBody,
    DrawnSolid as DrawnSolid,
    View as View,
    draw_mesh as draw_mesh,
    relief as relief,
    solid_sheet as solid_sheet,
)
