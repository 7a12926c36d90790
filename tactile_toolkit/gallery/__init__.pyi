"""The public names of this package; type checkers read this list, and each name is imported on first use."""

from .items import (
    Gallery as Gallery,
    GalleryItem as GalleryItem,
    gallery_of_rows as gallery_of_rows,
    gallery_of_solids as gallery_of_solids,
    thumbnail as thumbnail,
)
from .site import (
    build_site as build_site,
)
