"""The public names of this package; type checkers read this list, and each name is imported on first use."""

from .scene import (
    build_meshes as build_meshes,
    Placement as Placement,
    Scene as Scene,
)
from .sampling import (
    sample_scene as sample_scene,
    sample_scenes as sample_scenes,
    SamplingExhausted as SamplingExhausted,
    SceneSpec as SceneSpec,
)
from .scene_dataset import (
    generate as generate,
    load as load,
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
    Ring as Ring,
    Shape as Shape,
    Star as Star,
)

__version__: str
