"""Fast environments of touch with the episodes of the published ones; they need no OpenGL.

Importing the module registers them with gymnasium: ``gymnasium.make``, ``gymnasium.make_vec`` and
``ap_gym.make_vec`` take ids of `tactile-mnist` with ``tactile_envs/`` before them, such as
``"tactile_envs/TactileMNIST-Depth-train-v0"``. ``tactile_envs.ids()`` lists all ids.
"""

from lazy_loader import attach_stub

from tactile_envs.env_specs import register
from tactile_toolkit import __version__ as __version__

__getattr__, __dir__, __all__ = attach_stub(__name__, __file__)

register()
