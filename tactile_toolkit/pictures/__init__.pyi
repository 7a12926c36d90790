"""The public names of this package; type checkers read this list, and each name is imported on first use."""

from .sheets import (
    Drawn as Drawn,
    fitted as fitted,
    Pen as Pen,
    sheet as sheet,
    Tile as Tile,
)
from .previews import (
    ChosenRows as ChosenRows,
    PicturePlan as PicturePlan,
    PictureTask as PictureTask,
)
from .solid_views import (
    DrawnSolid as DrawnSolid,
    View as View,
    draw_mesh as draw_mesh,
)
