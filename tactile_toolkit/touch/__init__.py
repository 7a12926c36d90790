"""Records of touches: their published schema and rows, and the codecs of their images and clips.

``schema`` names and types the columns, ``rows`` packs arrays into them and takes touches out of them,
``jpeg`` decodes and encodes images, ``avi`` finds the frames of a clip and writes one.
"""

from lazy_loader import attach_stub

__getattr__, __dir__, __all__ = attach_stub(__name__, __file__)
