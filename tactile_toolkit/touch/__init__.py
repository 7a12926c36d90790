"""Records of touches: their published schema and rows, and the codecs of their images and clips.

``schema`` names and types the columns, ``rows`` packs arrays into them and takes touches out of them,
``jpeg`` decodes and encodes images, ``avi`` finds the frames of a clip and writes one.
"""
