"""The public names of this package; type checkers read this list, and each name is imported on first use."""

from .items import (
    Gallery as Gallery,
    GalleryItem as GalleryItem,
    gallery_of_rows as gallery_of_rows,
)
from .page import (
    NONE as NONE,
)
from .site import (
    PAGE_FILE as PAGE_FILE,
    build_site as build_site,
    site_folder as site_folder,
)
from .thumbnails import (
    THUMBNAIL_PX as THUMBNAIL_PX,
    relief_thumbnail as relief_thumbnail,
    thumbnail as thumbnail,
)
from .viewer_mesh import (
    packed_mesh as packed_mesh,
    require_mesh as require_mesh,
    size_text as size_text,
)
