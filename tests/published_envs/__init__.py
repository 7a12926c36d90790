"""The environments of the package `tactile-mnist` 0.13.0 on data sets of this toolkit: the truth of tests.

The package's own registration makes them; only the functions by which it fetches data from the Hub are
replaced while an environment is made. Rows have the published columns and are read by the published classes.
"""

from __future__ import annotations

import os
from collections.abc import Mapping
from dataclasses import replace
from importlib import import_module
from os import PathLike
from pathlib import Path
from typing import Any
from unittest.mock import patch

import numpy as np

from env_assets import MeshView
from env_assets.provider import meshes_at
from realtouch import TouchSingleDataset

__all__ = ["make", "mesh_dataset", "published_package", "registrations", "touch_dataset"]

TOUCHES = "real-single"
"""Name for the provider of the recorded touches."""

_ASSETS = {"mnist3d": "mnist3d", "wrench": "wrench", "abc-dataset-small": "abc"}
"""Names for the provider of what the registration fetches from the Hub by a name; it makes all else."""


def published_package(name: str) -> Any:
    """Import a published package, which draws without a screen; ImportError if it is not installed."""
    # OpenGL reads this once, when it is first imported.
    os.environ.setdefault("PYOPENGL_PLATFORM", "egl")
    return import_module(name)


def registrations() -> dict[str, Any]:
    """Return the registration of each published id; its settings are ``kwargs["default_config"]``."""
    published_package("tactile_mnist")
    registry = published_package("gymnasium").registry
    # Beside `tactile_envs`, which has the same ids, they have a prefix there.
    published = [spec for spec in registry.values() if "default_config" in spec.kwargs]
    return {spec.id: spec for spec in published}


def make(
    env_id: str,
    *,
    provider: Any = None,
    assets: Any = None,
    num_envs: int | None = None,
    config: Mapping[str, Any] | None = None,
    **options: Any,
) -> Any:
    """Make a published environment, or ``num_envs`` as a vector, as ``ap_gym.make`` does.

    Its objects are those of a provider, or ``assets``: a place of meshes, or a data set of them. Recorded
    touches are those of the provider. ``config`` has settings that differ from those of the registration.
    """
    tactile_mnist, ap_gym = published_package("tactile_mnist"), published_package("ap_gym")

    def simulated(named: Any, split: str, args: Any, default: Any, own: Any = None, _: Any = None) -> Any:
        settings = {**default, **(own or {})}
        meshes = assets
        if isinstance(assets, (str, PathLike)):
            meshes = meshes_at(assets, split)
        elif assets is None:
            made = {tactile_mnist.StarstruckMeshDataset: "starstruck"}.get(named, "minecraft")
            meshes = provider.meshes(_ASSETS.get(named, made), split)
        # Its own turn fails with scipy 1.17, whose rotations refuse the read-only corners of trimesh's boxes.
        flat = settings.pop("smallest_dimension_up", False)
        noise = settings.get("sensor_noise")
        if noise is not None and noise.real_base_depth_dataset is not None:
            place = _folder(provider.touches(TOUCHES))
            settings["sensor_noise"] = replace(noise, real_base_depth_dataset=place)
        return tactile_mnist.TactilePerceptionConfig(mesh_dataset(meshes, flat), *args, **settings)

    def recorded(_: str, __: str, split: str, printed: str, args: Any, default: Any, own: Any = None) -> Any:
        shown = {"mesh_dataset": mesh_dataset(provider.meshes("mnist3d", printed))}
        settings = {**shown, **default, **(own or {})}
        rounds = touch_dataset(provider.touches(TOUCHES, split), split)
        return tactile_mnist.TactileRealSnapConfig(rounds, *args, **settings)

    spec, registration = registrations()[env_id], published_package("tactile_mnist.registration")
    with patch.multiple(registration, mk_config=simulated, mk_real_snap_config=recorded):
        if num_envs is None:
            return ap_gym.make(spec, config=dict(config or {}), **options)
        return ap_gym.make_vec(spec, num_envs=num_envs, config=dict(config or {}), **options)


def mesh_dataset(meshes: Any, flat: bool = False) -> Any:
    """Return meshes as a ``tactile_mnist.SimpleMeshDataset``, turned onto their broadest side if ``flat``."""
    from datasets import ClassLabel, Dataset, Features, List, Value

    view = replace(MeshView.of(meshes), flat=flat)
    corners, triangles = (List(List(Value(kind), length=3)) for kind in ("float32", "int32"))
    features = Features(
        {
            "id": Value("int64"),
            "label": ClassLabel(names=list(view.label_names)),
            "mesh": {"vertices": corners, "faces": triangles},
        }
    )
    rows = [
        {
            "id": int(each.id),
            "label": int(each.label),
            "mesh": {"vertices": np.asarray(each.vertices_m), "faces": np.asarray(each.faces)},
        }
        for each in view
    ]
    stored = Dataset.from_list(rows, features=features)
    return published_package("tactile_mnist").SimpleMeshDataset(stored, cache_size="full")


def touch_dataset(rounds: TouchSingleDataset, split: str) -> Any:
    """Return rounds as a ``tactile_mnist.TouchSingleDataset``, which reads their folder."""
    from datasets import load_dataset

    stored = load_dataset(_folder(rounds), split=split)
    return published_package("tactile_mnist").TouchSingleDataset(stored)


def _folder(rounds: TouchSingleDataset) -> str:
    return str(Path(rounds.files[0].path).resolve().parents[1])
