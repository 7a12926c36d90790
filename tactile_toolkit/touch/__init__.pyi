"""The public names of this package; type checkers read this list, and each name is imported on first use."""

from .contact import (
    CELL_M as CELL_M,
    PRESS_DEPTH_M as PRESS_DEPTH_M,
    GELSIGHT_MINI as GELSIGHT_MINI,
    HeightRule as HeightRule,
    sensor_family as sensor_family,
    size_option as size_option,
)
from .images import (
    CLASS_NAMES as CLASS_NAMES,
    decode_image as decode_image,
    encode_image as encode_image,
    EncodedImage as EncodedImage,
    IMAGE_SUFFIX as IMAGE_SUFFIX,
    ImageFormat as ImageFormat,
    MAX_IMAGE_BYTES as MAX_IMAGE_BYTES,
    MAX_IMAGE_PIXELS as MAX_IMAGE_PIXELS,
    MEDIA_TYPE as MEDIA_TYPE,
    picture_formats as picture_formats,
    PICTURE_ENDINGS as PICTURE_ENDINGS,
    resized as resized,
    with_features as with_features,
)
