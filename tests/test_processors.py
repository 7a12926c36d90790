"""Data sets, reports, cards and pictures have the same bytes on every processor; simulated touches, nearly.

Libraries select code at their start by the available instructions. Their own switches make them use that of
another processor.
"""

from __future__ import annotations

import hashlib
import os
import platform
import subprocess
import sys
from importlib.util import find_spec
from pathlib import Path

import numpy as np
import pytest

from tests.processor_bytes import SIMULATED
from tests.realtouch.factories import make_round, seq_rows, single_rows, write_set

ROOT = Path(__file__).parents[1]

# The names of its groups of instructions differ from one version of numpy to the next.
DISPATCHED = " ".join(np._core._multiarray_umath.__cpu_dispatch__)

PROCESSORS = {
    "OpenBLAS for Haswell": {"OPENBLAS_CORETYPE": "Haswell"},
    "OpenBLAS for SkylakeX": {"OPENBLAS_CORETYPE": "SkylakeX"},
    "no AVX anywhere": {
        "OPENBLAS_CORETYPE": "Nehalem",
        "NPY_DISABLE_CPU_FEATURES": DISPATCHED,
        # The C library: its sine, exponential and logarithm.
        "GLIBC_TUNABLES": "glibc.cpu.hwcaps=-AVX,-AVX2,-FMA,-FMA4,-AVX512F,-AVX512VL,-AVX512BW,-AVX512DQ",
        "ARROW_USER_SIMD_LEVEL": "NONE",
        "JSIMD_FORCENONE": "1",
        # Compiled code of numba: no wide registers, and no fused multiply-add.
        "NUMBA_CPU_NAME": "nehalem",
        "NUMBA_CPU_FEATURES": "",
    },
}


def made_on(
    settings: dict[str, str], folder: Path, touches: Path
) -> tuple[dict[str, str], dict[str, np.ndarray]]:
    """Return digests of files, and results of the simulation."""
    environment = {**os.environ, **settings, "TACTILE_TOOLKIT_CACHE": str(folder.with_suffix(".cache"))}
    # Features that a processor lacks cannot be switched off: NumPy warns, and continues.
    command = [sys.executable, "-W", "ignore", "-m", "tests.processor_bytes", str(folder), str(touches)]
    result = subprocess.run(command, cwd=ROOT, env=environment, capture_output=True, text=True, check=False)
    assert result.returncode == 0, result.stderr
    files = sorted(file for file in folder.rglob("*") if file.is_file() and file.name != SIMULATED)
    digests = {str(file.relative_to(folder)): hashlib.sha256(file.read_bytes()).hexdigest() for file in files}
    with np.load(folder / SIMULATED) as simulated:
        return digests, dict(simulated)


@pytest.fixture(scope="module")
def touches(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("touches")
    rounds = [make_round(index, 6, (64, 48), (12, 16)) for index in range(2)]
    write_set(folder / "clips", {"train": seq_rows(rounds)}, "seq")
    write_set(folder / "images", {"train": single_rows(rounds)}, "single")
    return folder


@pytest.fixture(scope="module")
def made_here(
    tmp_path_factory: pytest.TempPathFactory, touches: Path
) -> tuple[dict[str, str], dict[str, np.ndarray]]:
    return made_on({}, tmp_path_factory.mktemp("here") / "made", touches)


@pytest.mark.thorough
@pytest.mark.skipif(platform.machine() not in ("x86_64", "AMD64"), reason="the switches are those of x86-64")
@pytest.mark.parametrize("processor", PROCESSORS)
def test_another_processor_writes_the_same(processor, made_here, touches, tmp_path):
    needs_avx512 = PROCESSORS[processor]["OPENBLAS_CORETYPE"] == "SkylakeX"
    if needs_avx512 and "avx512f" not in Path("/proc/cpuinfo").read_text():
        pytest.skip("this processor has no AVX-512, which kernels for SkylakeX are made of")
    here, simulated_here = made_here
    assert find_spec("taxim") is None or "shades" in simulated_here
    assert {"digits/reports/printability.parquet", "digits/previews/digits.png"} <= set(here)
    there, simulated_there = made_on(PROCESSORS[processor], tmp_path / "made", touches)
    assert there == here
    for name, field in simulated_here.items():
        np.testing.assert_allclose(simulated_there[name], field, rtol=0, atol=1e-6 * np.abs(field).max())
