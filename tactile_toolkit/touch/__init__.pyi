"""The public names of this package; type checkers read this list, and each name is imported on first use."""

from .contact import (
    CELL_M as CELL_M,
    PRESS_DEPTH_M as PRESS_DEPTH_M,
    RENDERED_CONTACT_M as RENDERED_CONTACT_M,
    contact_height_option as contact_height_option,
    height_text as height_text,
    missed_text as missed_text,
    size_option as size_option,
)
from .images import (
    CLASS_NAMES as CLASS_NAMES,
    decode_image as decode_image,
    decode_small as decode_small,
    encode_image as encode_image,
    encode_png as encode_png,
    image_size as image_size,
    IMAGE_SUFFIX as IMAGE_SUFFIX,
    ImageFormat as ImageFormat,
    intact_size as intact_size,
    is_jpeg as is_jpeg,
    Kind as Kind,
    MAX_IMAGE_BYTES as MAX_IMAGE_BYTES,
    MAX_IMAGE_PIXELS as MAX_IMAGE_PIXELS,
    MEDIA_COLUMN as MEDIA_COLUMN,
    MEDIA_TYPE as MEDIA_TYPE,
    require_bounded_jpeg as require_bounded_jpeg,
    resized as resized,
    upright_size as upright_size,
    with_features as with_features,
)
