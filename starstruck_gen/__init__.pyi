"""The public names of this package; type checkers read this list, and each name is imported on first use."""

from .placement import Placement as Placement
from .rejection import (
    SamplingExhausted as SamplingExhausted,
    require_feasible as require_feasible,
    sample_scene as sample_scene,
    sample_scenes as sample_scenes,
)
from .scene import Scene as Scene
from .scene_card import summarise as summarise
from .scene_checks import (
    CheckedScenes as CheckedScenes,
    validate_folder as validate_folder,
)
from .scene_dataset import (
    SceneMeshDataset as SceneMeshDataset,
    SceneRecord as SceneRecord,
    load as load,
)
from .scene_generation import (
    PUBLISHED_SIZES as PUBLISHED_SIZES,
    SceneGenerator as SceneGenerator,
    SceneSetSpec as SceneSetSpec,
    generate as generate,
)
from .scene_meshes import (
    SceneMeshes as SceneMeshes,
    build_meshes as build_meshes,
)
from .scene_seeds import (
    SPLITS as SPLITS,
    scene_rng as scene_rng,
    scene_seed as scene_seed,
)
from .scene_spec import SceneSpec as SceneSpec
from .scenes_on_the_fly import SceneDataset as SceneDataset
from .shape_kinds import (
    Crescent as Crescent,
    Cross as Cross,
    Disc as Disc,
    Proportions as Proportions,
    Ring as Ring,
    Star as Star,
)
from .shape_registry import register_shape as register_shape
from .shapes import Shape as Shape

__version__: str
