"""Options with which environments are made."""

from __future__ import annotations

from dataclasses import dataclass
from os import PathLike
from pathlib import Path

from gymnasium.vector import AutoresetMode

from tactile_envs import gym_types
from tactile_envs.config import EpisodeConfig


@dataclass(frozen=True, slots=True, kw_only=True)
class MakeOptions:
    """Options of :func:`tactile_envs.make_vector`.

    Parameters
    ----------
    num_envs : int
        Number of environments.
    assets : path or str, optional
        Meshes: a folder of data sets (such as ``tactile-assets``, with ``mnist3d`` in it), one data set by
        folder or name on the Hub, a folder of mesh files, or ``"published"`` for the published set. By
        default they are made on first use in ``tactile-assets``; environments of classes begin meanwhile.
        For ids with ``RealSnap``: the touched digits and, unless `touches` are given, the touches; a folder
        of both (``mnist3d`` and ``real-single``) or a data set of touches, the published ones by default.
    unit : "mm", "cm", "m" or "in", optional
        Unit of mesh files that state none (STL, PLY, OBJ); millimetres by default.
    config : mapping or Config, optional
        Settings that differ from those of the id, or all of them; see :class:`tactile_envs.Config`.
    render_mode : "rgb_array", optional
        If given, ``render()`` returns pictures.
    threads : int
        Number of threads that share a step.
    weights : path or str, optional
        Weights for the sensor of CycleGAN environments, ``depth_to_touch.npz`` of ``tactile-sim train``; the
        published ones by default.
    touches : path or str, optional
        Recorded touches for ids with ``RealSnap``: a data set by folder or name on the Hub, or
        ``"published"``. Volumes need the touched digits; classes do not, but pictures show them if `assets`
        are given.
    autoreset_mode : gymnasium.vector.AutoresetMode or str
        When the next episode begins; see :class:`tactile_envs.TactileVectorEnv`.
    max_episode_steps : int, optional
        The setting ``step_limit``, as gymnasium names it.
    """

    num_envs: int = 1
    assets: str | PathLike[str] | None = None
    unit: str | None = None
    config: gym_types.Options | EpisodeConfig | None = None
    render_mode: str | None = None
    threads: int = 1
    weights: str | Path | None = None
    touches: str | PathLike[str] | None = None
    autoreset_mode: AutoresetMode | str = AutoresetMode.NEXT_STEP
    max_episode_steps: int | None = None
