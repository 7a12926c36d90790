from __future__ import annotations

import subprocess
import sys


def test_import_brings_no_heavy_library():
    heavy = "{'numpy', 'pyarrow', 'manifold3d', 'trimesh', 'datasets', 'scipy', 'PIL'}"
    code = f"import sys, starstruck_gen; assert not {heavy} & set(sys.modules)"
    subprocess.run([sys.executable, "-c", code], check=True)
