"""The public names: type checkers read this list, and the package imports each on first use."""

from tactile_envs.config import IDS as IDS, Config as Config
from tactile_envs.environment import TactileEnv as TactileEnv, TactileVectorEnv as TactileVectorEnv
from tactile_envs.making import make_one as make_one, make_vector as make_vector
from tactile_envs.config import register as register

__version__: str
