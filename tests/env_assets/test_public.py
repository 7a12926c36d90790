from __future__ import annotations

import pytest

import env_assets
from tests.processes import printed_by

ADAPTERS = {"as_mesh_dataset", "as_touch_dataset"}
"""These need the packages of the extra ``env``."""


def test_every_public_name_is_there():
    for name in set(env_assets.__all__) - ADAPTERS:
        assert getattr(env_assets, name) is not None
    assert dir(env_assets) == sorted(env_assets.__all__)
    with pytest.raises(AttributeError, match="no attribute 'nothing'"):
        _ = env_assets.nothing


def test_no_module_bears_a_public_name():
    """Importing it would take the place of the function once something imports it."""
    import pkgutil

    modules = {module.name for module in pkgutil.iter_modules(env_assets.__path__)}
    assert not modules & set(env_assets.__all__)


def test_import_brings_no_heavy_library():
    heavy = "{'numpy', 'pyarrow', 'manifold3d', 'trimesh', 'datasets', 'scipy', 'PIL', 'tactile_mnist'}"
    code = f"import sys, env_assets; assert not {heavy} & set(sys.modules)"
    printed_by(code)


def test_a_provider_needs_no_package_of_environments(assets):
    code = (
        "import sys, env_assets\n"
        "provider = env_assets.AssetProvider(sys.argv[1])\n"
        "provider.height_map(provider.meshes('mnist3d', 'test')[0], 0.001)\n"
        "heavy = {'tactile_mnist', 'ap_gym', 'gymnasium', 'torch', 'jax', 'datasets'}\n"
        "assert not heavy & set(sys.modules), heavy & set(sys.modules)"
    )
    printed_by(code, assets)
