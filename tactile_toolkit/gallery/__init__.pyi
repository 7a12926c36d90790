"""The public names of this package; type checkers read this list, and each name is imported on first use."""

from .site import (
    Gallery as Gallery,
    GalleryItem as GalleryItem,
)
