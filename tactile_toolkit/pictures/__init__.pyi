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
    plan_sheets as plan_sheets,
)
from .sheets import (
    ACCENTS as ACCENTS,
    INK as INK,
    PAPER as PAPER,
    Tile as Tile,
    bar_length_mm as bar_length_mm,
    Pen as Pen,
    fitted as fitted,
    sheet as sheet,
)
from .solid_views import (
    DrawnBody as DrawnBody,
    DrawnSolid as DrawnSolid,
    View as View,
    draw_mesh as draw_mesh,
    relief as relief,
    solid_sheet as solid_sheet,
)
