"""Starstruck: scenes of stars among distractors, made by rejection sampling.

``starstruck_gen.load`` opens a data set, ``starstruck_gen.generate`` makes one,
``starstruck_gen.SceneDataset`` gives the same records without any files, and ``starstruck_gen.sample_scene``
makes a single scene. Names are imported on first use, so that ``import starstruck_gen`` costs nothing.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from tactile_toolkit.lazy_names import on_first_use

if TYPE_CHECKING:
    from starstruck_gen.dataset import SceneMeshDataset, SceneRecord, load
    from starstruck_gen.endless import SceneDataset
    from starstruck_gen.generation import GenerateSpec, generate
    from starstruck_gen.placement import Placement, SceneMeshes, build_meshes, stamp
    from starstruck_gen.sampling import SamplingExhausted, sample_scene, sample_scenes
    from starstruck_gen.scene import Scene
    from starstruck_gen.shapes import OUTLINES, Crescent, Cross, Disc, Proportions, Ring, Shape, Star
    from starstruck_gen.solid import register_shape
    from starstruck_gen.spec import SceneSpec
    from starstruck_gen.streams import SPLITS, scene_rng, scene_seed

__all__ = [
    "OUTLINES",
    "SPLITS",
    "Crescent",
    "Cross",
    "Disc",
    "GenerateSpec",
    "Placement",
    "Proportions",
    "Ring",
    "SamplingExhausted",
    "Scene",
    "SceneDataset",
    "SceneMeshDataset",
    "SceneMeshes",
    "SceneRecord",
    "SceneSpec",
    "Shape",
    "Star",
    "build_meshes",
    "generate",
    "load",
    "register_shape",
    "sample_scene",
    "sample_scenes",
    "scene_rng",
    "scene_seed",
    "stamp",
]

__version__: str

__getattr__, __dir__ = on_first_use(
    __name__,
    {
        "starstruck_gen.dataset": ("SceneMeshDataset", "SceneRecord", "load"),
        "starstruck_gen.endless": ("SceneDataset",),
        "starstruck_gen.generation": ("GenerateSpec", "generate"),
        "starstruck_gen.placement": ("Placement", "SceneMeshes", "build_meshes", "stamp"),
        "starstruck_gen.sampling": ("SamplingExhausted", "sample_scene", "sample_scenes"),
        "starstruck_gen.scene": ("Scene",),
        "starstruck_gen.shapes": (
            "OUTLINES",
            "Crescent",
            "Cross",
            "Disc",
            "Proportions",
            "Ring",
            "Shape",
            "Star",
        ),
        "starstruck_gen.solid": ("register_shape",),
        "starstruck_gen.spec": ("SceneSpec",),
        "starstruck_gen.streams": ("SPLITS", "scene_rng", "scene_seed"),
    },
)
