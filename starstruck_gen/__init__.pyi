"""The public names of this package; type checkers read this list, and each name is imported on first use."""

from .scene import (
    build_meshes as build_meshes,
    Placement as Placement,
    Scene as Scene,
    SceneMeshes as SceneMeshes,
)
from .sampling import (
    require_feasible as require_feasible,
    sample_scene as sample_scene,
    sample_scenes as sample_scenes,
    SamplingExhausted as SamplingExhausted,
    scene_rng as scene_rng,
    scene_seed as scene_seed,
    SceneSpec as SceneSpec,
    SPLITS as SPLITS,
)
from .scene_checks import (
    CheckedScenes as CheckedScenes,
    validate_folder as validate_folder,
)
from .scene_dataset import (
    generate as generate,
    load as load,
    PUBLISHED_SIZES as PUBLISHED_SIZES,
    SceneDataset as SceneDataset,
    SceneGenerator as SceneGenerator,
    SceneMeshDataset as SceneMeshDataset,
    SceneRecord as SceneRecord,
    SceneSetSpec as SceneSetSpec,
)
from .shapes import (
    Crescent as Crescent,
    Cross as Cross,
    Disc as Disc,
    Proportions as Proportions,
    Ring as Ring,
    Shape as Shape,
    Star as Star,
)

__version__: str
