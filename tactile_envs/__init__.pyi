"""The public names of this package; type checkers read this list, and each name is imported on first use."""

from . import wrappers as wrappers
from .config import Config as Config
from .env_specs import EnvId as EnvId, ids as ids
from .entry_points import (
    make_one as make_one,
    make_vector as make_vector,
    MakeOptions as MakeOptions,
    TactileEnv as TactileEnv,
)
from .environment import TactileVectorEnv as TactileVectorEnv
from .episodes.playing import EpisodeSpec as EpisodeSpec
from .episodes.evaluation import evaluate as evaluate
from .episodes.evaluation import Report as Report, compare as compare
from .episodes.recording import record as record
from .episodes.recording import replay as replay

__version__: str
