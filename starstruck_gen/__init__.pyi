"""The public names: type checkers read this list, and the package imports each on first use."""

from starstruck_gen.loader import (
    SceneMeshDataset as SceneMeshDataset,
    SceneRecord as SceneRecord,
    load as load,
)
from starstruck_gen.loader import SceneDataset as SceneDataset
from starstruck_gen.make import GenerateSpec as GenerateSpec, generate as generate
from starstruck_gen.placement import (
    Placement as Placement,
    SceneMeshes as SceneMeshes,
    build_meshes as build_meshes,
)
from starstruck_gen.sampling import (
    SamplingExhausted as SamplingExhausted,
    sample_scene as sample_scene,
    sample_scenes as sample_scenes,
)
from starstruck_gen.scene import Scene as Scene
from starstruck_gen.shapes import (
    OUTLINES as OUTLINES,
    Crescent as Crescent,
    Cross as Cross,
    Disc as Disc,
    Proportions as Proportions,
    Ring as Ring,
    Shape as Shape,
    Star as Star,
)
from starstruck_gen.placement import register_shape as register_shape
from starstruck_gen.spec import SceneSpec as SceneSpec
from starstruck_gen.sampling import SPLITS as SPLITS, scene_rng as scene_rng, scene_seed as scene_seed

__version__: str
