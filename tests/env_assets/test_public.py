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


IMPORTS = """
import sys
def require_none(*names, of):
    found = {name for name in of if name in names or name.split(".")[0] in names}
    assert not found, found
import env_assets
require_none(
    "numpy", "pyarrow", "manifold3d", "trimesh", "datasets", "scipy", "PIL", "tactile_mnist", of=sys.modules
)
provider = env_assets.AssetProvider(sys.argv[1])
require_none("trimesh", "pyarrow.parquet", of=sys.modules)
digits = provider.meshes("mnist3d", "test")
# A child forked while a thread imports would wait for ever for that import.
before = set(sys.modules)
digits[0].mesh, digits[0].vertices_m, digits.ids
require_none("trimesh", "pyarrow", "numpy", "pandas", of=set(sys.modules) - before)
provider.height_map(digits[0], 0.001)
require_none("tactile_mnist", "ap_gym", "gymnasium", "torch", "jax", "datasets", of=sys.modules)
"""


def test_importing_opening_and_reading_bring_what_they_need_and_no_environment(assets):
    printed_by(IMPORTS, assets)
