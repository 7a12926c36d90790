"""The public names of this package; type checkers read this list, and each name is imported on first use."""

from .config import Config as Config
from .entry_points import make_one as make_one, make_vector as make_vector
from .environment import TactileEnv as TactileEnv, TactileVectorEnv as TactileVectorEnv
from .ids import IDS as IDS, register as register

__version__: str
