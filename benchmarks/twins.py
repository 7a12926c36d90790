"""How good the twins of hidden sensors are, and whether planted mistakes are named.

Usage: python benchmarks/twins.py [--sensors 200] [--families taxim phong published] [--touches 20]

Each sensor is drawn by ``tests/tactile_sim/hidden_sensors.py``, which shares no code with the fit. It is
calibrated with touches of four digits whose poses are off by 0.1 mm and 0.5 degrees, and judged by touches of
four others.
"""

from __future__ import annotations

import argparse
import sys
from dataclasses import asdict
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from tests.tactile_sim.hidden_sensors import MISTAKES, draw_sensor
from tests.tactile_sim.twin_scores import named_mistakes, score, table


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--sensors", type=int, default=200)
    parser.add_argument("--first", type=int, default=0)
    parser.add_argument("--families", nargs="+", default=["taxim", "phong", "published"])
    parser.add_argument("--touches", type=int, default=20)
    parser.add_argument("--mistakes", type=int, default=3)
    given = parser.parse_args()
    for family in given.families:
        scores = []
        for seed in range(given.first, given.first + given.sensors):
            made, _ = score(draw_sensor(seed, family), given.touches)
            print(
                {
                    name: round(value, 4) if isinstance(value, float) else value
                    for name, value in asdict(made).items()
                },
                flush=True,
            )
            scores.append(made)
        print(table(scores), flush=True)
    for seed in range(given.mistakes):
        for mistake in (None, *MISTAKES):
            found = named_mistakes(given.families[seed % len(given.families)], seed, mistake)
            is_right = found == set() if mistake is None else mistake in found
            print(f"{mistake or 'clean'}: {sorted(found)} {'' if is_right else 'WRONG'}", flush=True)


if __name__ == "__main__":
    main()
