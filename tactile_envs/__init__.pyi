"""The public names of this package; type checkers read this list, and each name is imported on first use."""

from .config import IDS as IDS, Config as Config
from .environment import TactileEnv as TactileEnv, TactileVectorEnv as TactileVectorEnv
from .making import make_one as make_one, make_vector as make_vector
from .config import register as register

__version__: str
