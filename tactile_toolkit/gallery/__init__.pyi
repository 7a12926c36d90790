"""The public names of this package; type checkers read this list, and each name is imported on first use."""

from .items import (
    Facet as Facet,
    Gallery as Gallery,
    Item as Item,
    Measure as Measure,
    NONE as NONE,
    THUMBNAIL_PX as THUMBNAIL_PX,
    gallery_of_rows as gallery_of_rows,
    packed_mesh as packed_mesh,
    relief_thumbnail as relief_thumbnail,
    require_mesh as require_mesh,
    size_text as size_text,
    thumbnail as thumbnail,
)
from .site import (
    PAGE_FILE as PAGE_FILE,
    build_site as build_site,
    site_folder as site_folder,
)
