"""The public names of this package; type checkers read this list, and each name is imported on first use."""

from .previews import (
    MeshPreviews as MeshPreviews,
    draw_by_class as draw_by_class,
)
from .render import (
    Body as Body,
    OBLIQUE as OBLIQUE,
    box_downsample as box_downsample,
    draw_bodies as draw_bodies,
    relief as relief,
    relief_of as relief_of,
    relief_tile_html as relief_tile_html,
)
from .sheets import (
    ACCENTS as ACCENTS,
    PAPER as PAPER,
    PicturePlan as PicturePlan,
    PlannedPicture as PlannedPicture,
    TILE_STYLE as TILE_STYLE,
    Tile as Tile,
    bar_length_mm as bar_length_mm,
    draw_text as draw_text,
    figure_html as figure_html,
    file_stem as file_stem,
    in_rows as in_rows,
    plan_kinds as plan_kinds,
    png_bytes as png_bytes,
    sheet as sheet,
    text_size as text_size,
    with_scale_bar as with_scale_bar,
    write_pictures as write_pictures,
)
