"""The public names of this package; type checkers read this list, and each name is imported on first use."""

from .loader import (
    SceneMeshDataset as SceneMeshDataset,
    SceneRecord as SceneRecord,
    load as load,
)
from .loader import SceneDataset as SceneDataset
from .make import GenerateSpec as GenerateSpec, generate as generate
from .placement import (
    Placement as Placement,
    SceneMeshes as SceneMeshes,
    build_meshes as build_meshes,
)
from .sampling import (
    SamplingExhausted as SamplingExhausted,
    sample_scene as sample_scene,
    sample_scenes as sample_scenes,
)
from .scene import Scene as Scene
from .shapes import (
    OUTLINES as OUTLINES,
    Crescent as Crescent,
    Cross as Cross,
    Disc as Disc,
    Proportions as Proportions,
    Ring as Ring,
    Shape as Shape,
    Star as Star,
)
from .placement import register_shape as register_shape
from .spec import SceneSpec as SceneSpec
from .sampling import SPLITS as SPLITS, scene_rng as scene_rng, scene_seed as scene_seed
from .make import SceneMaking as SceneMaking, PUBLISHED_SIZES as PUBLISHED_SIZES
from .sampling import require_feasible as require_feasible
from .card import summarise as summarise
from .validate import validate_folder as validate_folder, Checked as Checked

__version__: str
