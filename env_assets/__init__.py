"""Assets for environments: meshes, touches, volumes and height maps, from files, from the Hub or generated.

``env_assets.AssetProvider`` provides them, ``env_assets.top_surface`` turns a mesh into a height map and
``env_assets.write_wrench`` makes the wrench. Names are imported on first use, so that ``import env_assets``
costs nothing.
"""

from lazy_loader import attach_stub

from tactile_toolkit import __version__ as __version__

__getattr__, __dir__, __all__ = attach_stub(__name__, __file__)
