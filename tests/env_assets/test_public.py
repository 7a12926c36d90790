from __future__ import annotations

from tests.processes import printed_by

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
