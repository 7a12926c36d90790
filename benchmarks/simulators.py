"""How long bodies for simulators take, and how close their convex parts are; processor time of one core.

python benchmarks/simulators.py [--digits 100]
"""

from __future__ import annotations

import argparse
import sys
import time
from pathlib import Path

import numpy as np
from figures import tell

import mnist3d
from mnist3d.sources.synthetic import SyntheticSource
from tactile_toolkit.printing.print_options import Physics
from tactile_toolkit.printing.simulator import convex_parts, model_files

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))
_LOOKED_AT = 25  # for the distance: every corner and face is compared with every part


def main() -> None:
    from tests.tactile_toolkit.printing.test_convex import outside_mm

    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--digits", type=int, default=100)
    count = parser.parse_args().digits
    source = SyntheticSource()
    numbers = np.random.default_rng(0).choice(len(source.catalog()), count, replace=False).tolist()
    times_s, counts, shares, outside = [], [], [], []
    for number in numbers:
        solid = mnist3d.solidify(source.image(number).pixels)
        start_s = time.process_time()
        model_files("digit", solid, ".xml", Physics())
        times_s.append(time.process_time() - start_s)
        parts = convex_parts(solid)
        counts.append(len(parts))
        shares.append(sum(part.volume_m3 for part in parts) / solid.volume_m3)
        if len(outside) < _LOOKED_AT:
            outside.append(outside_mm(solid, parts))
    tell(
        "body", "a digit as a body, MJCF: parts, mass, inertia, file", float(np.median(times_s)), "s",
        target="at most 0.5", note=f"worst {1e3 * max(times_s):.0f} ms; {np.median(counts):.0f} parts",
    )  # fmt: skip
    tell(
        "hulls", "volume of the parts, in volumes of the digit, worst", max(shares), "times",
        target="at most 1.10", note=f"median {np.median(shares):.3f}",
    )  # fmt: skip
    tell(
        "outside", "how far the digit stands out of the parts, worst", max(outside), "mm",
        target="at most 0.3", note=f"{len(outside)} digits",
    )  # fmt: skip


if __name__ == "__main__":
    main()
