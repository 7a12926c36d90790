"""Draw the curves of all seeds, and print their tables: ``python benchmarks/baseline/curves.py runs``."""

from __future__ import annotations

import argparse
import json
from pathlib import Path

import matplotlib as mpl
import numpy as np
from matplotlib import pyplot as plt

NAMES = {
    "rule": "rule: where the digit goes on",
    "learned": "policy: imitation, then PPO",
    "imitation": "policy: imitation alone",
    "random": "random actions, a reader of their own",
}


def interval(right: np.ndarray, random: np.random.Generator) -> tuple[float, float]:
    """Return bounds of the mean, 95 %, for other digits: right has shape (seeds, digits)."""
    of_digit = right.mean(0)
    means = random.choice(of_digit, (2000, len(of_digit))).mean(1)
    low, high = np.percentile(means, (2.5, 97.5))
    return float(low), float(high)


def main() -> None:
    """Write the picture, and print the tables."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("runs", type=Path)
    parser.add_argument("--out", type=Path, default=Path())
    options = parser.parse_args()
    runs = [json.loads(path.read_text()) for path in sorted(options.runs.glob("*/result.json"))]
    random = np.random.default_rng(0)
    mpl.use("Agg")
    figure, axes = plt.subplots(figsize=(6, 3.6), layout="constrained")
    print("| who touches | final | average | met the digit | touches of training |")
    print("| --- | --- | --- | --- | --- |")
    for name, title in NAMES.items():
        right = np.array([run[name]["right"] for run in runs])  # (seeds, digits, 16)
        curve, bounds = 100 * right.mean((0, 1)), []
        for touch in range(right.shape[2]):
            bounds.append(interval(right[:, :, touch], random))
        low, high = 100 * np.array(bounds).T
        axes.plot(np.arange(1, 17), curve, label=title)
        axes.fill_between(np.arange(1, 17), low, high, alpha=0.2)
        average = [100 * each for each in interval(right.mean(2), random)]
        met = np.mean([run[name]["met"][-1] for run in runs])
        touches = np.mean([run[name]["touches"] for run in runs])
        final = f"{curve[-1]:.1f} % ({low[-1]:.1f} to {high[-1]:.1f})"
        mean = f"{curve.mean():.1f} % ({average[0]:.1f} to {average[1]:.1f})"
        print(f"| {title} | {final} | {mean} | {met:.0%} | {touches / 1e6:.1f} million |")
    axes.axhline(10, color="grey", linewidth=0.8, linestyle=":")
    axes.set(xlabel="touches", ylabel="digits read, %", xlim=(1, 16), ylim=(0, 100))
    axes.legend(frameon=False, fontsize=8)
    figure.savefig(options.out / "curves.png", dpi=150)
    print(f"{len(runs)} seeds, {runs[0]['digits']['test']} digits of `test`, intervals over digits\n")
    print("| who touches | probability of the digit, final | average | above 10 %, final | average |")
    print("| --- | --- | --- | --- | --- |")
    for name in ("rule", "learned", "random"):
        certainty = np.array([run[name]["certainty"] for run in runs])
        shares = [
            100 * each.mean() for kind in (certainty, certainty > 0.1) for each in (kind[..., -1], kind)
        ]
        print(f"| {NAMES[name]} | " + " | ".join(f"{share:.1f} %" for share in shares) + " |")


if __name__ == "__main__":
    main()
