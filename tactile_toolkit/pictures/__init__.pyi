"""The public names of this package; type checkers read this list, and each name is imported on first use."""

from .lettering import (
    ACCENTS as ACCENTS,
    PAPER as PAPER,
    draw_text as draw_text,
    text_size as text_size,
)
from .oblique_views import (
    DrawnBody as DrawnBody,
    OBLIQUE as OBLIQUE,
    draw_bodies as draw_bodies,
)
from .picture_files import (
    PicturePlan as PicturePlan,
    PlannedPicture as PlannedPicture,
    TILE_STYLE as TILE_STYLE,
    figure_html as figure_html,
    file_stem as file_stem,
    plan_kinds as plan_kinds,
    png_bytes as png_bytes,
    write_pictures as write_pictures,
)
from .previews import (
    MeshPreviews as MeshPreviews,
    draw_by_class as draw_by_class,
)
from .relief_views import (
    box_downsample as box_downsample,
    relief as relief,
    relief_of as relief_of,
    relief_tile_html as relief_tile_html,
)
from .sheets import (
    Tile as Tile,
    bar_length_mm as bar_length_mm,
    in_rows as in_rows,
    sheet as sheet,
    with_scale_bar as with_scale_bar,
)
