"""Draw what the elastic gel gives beside the formulas of the textbook, and print their differences.

Usage: python docs/elastic.py      (extras test and pictures; two minutes)

``elastic.png`` has a curve for each printed row; the table in ``elastic.md`` has the greatest of each kind.
Formulas and the finite elements are those of the tests.
"""

from __future__ import annotations

import math
import sys
from functools import partial
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

import tactile_sim
from tactile_sim import GelLoad
from tactile_toolkit.cards.card import markdown_table
from tests.tactile_sim import elastic_formulas as formulas, test_elastic_elements as elements
from tests.tactile_sim.elastic_bodies import (
    E_PA,
    FREE,
    LAYER_M,
    REDUCED_PA,
    area_radius_m,
    grid,
    punch,
    punch_on_layer,
    shear_pa,
    sphere,
)

DOCS = Path(__file__).resolve().parent
FRICTION, FORCE_N, RADIUS_M = 0.4, 0.5, 0.02
FORMULA, OURS = {"color": "0.55", "linewidth": 1.6}, {"linestyle": "none", "marker": ".", "color": "tab:blue"}

Row = tuple[str, str, str]


def main() -> None:
    """Write the picture, and print the table."""
    figure = Figure(figsize=(11, 9), dpi=110, layout="constrained")
    axes = figure.subplots(3, 3).ravel()
    rows: list[Row] = []
    rows += draw_sphere(axes[0], axes[1])
    rows += draw_cone_and_punch(axes[2])
    rows += draw_cylinder(axes[3])
    rows += draw_layer(axes[4])
    rows += draw_thin_layers(axes[5])
    rows += draw_slide(axes[6])
    rows += draw_twist(axes[7])
    rows += draw_elements(axes[8])
    FigureCanvasAgg(figure).print_figure(DOCS / "elastic.png", metadata={"Software": None})
    table = markdown_table(("case", "reference", "difference (tolerance)"), rows)
    sys.stdout.write(f"{table}\n")


def label(axes: Any, title: str, x: str, y: str) -> None:
    """Name a curve and its axes."""
    axes.set_title(title, fontsize=9)
    axes.set_xlabel(x, fontsize=8)
    axes.set_ylabel(y, fontsize=8)
    axes.tick_params(labelsize=7)


def row(case: str, source: str, expected: float, computed: float, within: str) -> Row:
    """Return a row of the table: the difference from the reference, and the tolerance of the test."""
    return case, source, f"{computed / expected - 1:+.2%} ({within})"


def draw_sphere(left: Any, right: Any) -> list[Row]:
    """Draw pressure and surface of a sphere on a half-space along a row of pixels."""
    count, depth_m = 128, 1e-3
    pixel_m = 0.016 / count
    heights = sphere(count, pixel_m, RADIUS_M)
    contact = tactile_sim.solve_contact(
        heights, pixel_m, GelLoad(depth_m=depth_m, gel=FREE), thickness_m=math.inf
    )
    force_n, contact_m, peak_pa = formulas.hertz(depth_m - heights.max(), RADIUS_M, REDUCED_PA)
    x = grid(count, pixel_m)[0][0]
    line = count // 2
    dense = np.linspace(-1, 1, 401)
    left.plot(1e3 * contact_m * dense, peak_pa / 1e3 * np.sqrt(1 - dense**2), **FORMULA, label="Hertz")
    left.plot(1e3 * x, contact.pressure_pa[line] / 1e3, **OURS, label="here")
    left.legend(fontsize=7)
    label(left, "sphere on a half-space: pressure", "mm", "kPa")
    outside = np.linspace(contact_m, x[-1], 200)
    sunk = formulas.hertz_outside(outside, depth_m, contact_m)
    inside = np.linspace(0, contact_m, 50)
    right.plot(1e3 * inside, 1e3 * (depth_m - inside**2 / (2 * RADIUS_M)), **FORMULA)
    right.plot(1e3 * outside, 1e3 * sunk, **FORMULA)
    right.plot(1e3 * x[line:], 1e3 * contact.displacement_m[line, line:, 2], **OURS)
    label(right, "sphere: how deep the surface lies", "mm from the middle", "mm")
    found_m = area_radius_m(contact.is_contact, pixel_m)
    return [
        row("sphere: force", "Hertz", force_n, contact.force_n[2], "0.1 %"),
        row("sphere: radius of contact", "Hertz", 1e3 * contact_m, 1e3 * found_m, "1 %"),
    ]


def draw_cone_and_punch(axes: Any) -> list[Row]:
    """Draw the force of a cone and of a flat punch over the depth."""
    count, slope, wide_m = 128, 0.1, 0.004
    pixel_m = 0.01 / count
    x, y = grid(count, pixel_m)
    cone = -slope * np.hypot(x, y)
    depths = np.linspace(5e-5, 3e-4, 6)
    how: dict[str, Any] = {"thickness_m": math.inf}
    cones = [
        tactile_sim.solve_contact(
            cone, pixel_m, GelLoad(depth_m=depth + cone.max(), gel=FREE), **how
        ).force_n[2]
        for depth in depths
    ]
    flat = punch(count, pixel_m, wide_m)
    punches = [
        tactile_sim.solve_contact(flat, pixel_m, GelLoad(depth_m=depth, gel=FREE), **how).force_n[2]
        for depth in depths
    ]
    expected_cone = formulas.cone_force(depths, slope, REDUCED_PA)
    expected_punch = formulas.punch_force(depths, wide_m, REDUCED_PA)
    for expected, computed in ((expected_cone, cones), (expected_punch, punches)):
        axes.plot(1e3 * depths, expected, **FORMULA)
        axes.plot(1e3 * depths, computed, **OURS)
    label(axes, "flat punch (above) and cone: force", "mm deep", "N")
    return [
        row("cone: force", "Sneddon", expected_cone[-1], cones[-1], "0.5 %"),
        row("flat punch: force", "Sneddon", expected_punch[-1], punches[-1], "1 %"),
    ]


def draw_cylinder(axes: Any) -> list[Row]:
    """Draw the pressure across the middle of a long cylinder."""
    rows, columns, pixel_m = 512, 64, 5e-5
    x = (np.arange(columns) - (columns - 1) / 2) * pixel_m
    heights = np.broadcast_to(-(x**2) / (2 * RADIUS_M), (rows, columns))
    contact = tactile_sim.solve_contact(
        heights, pixel_m, GelLoad(depth_m=1e-4, gel=FREE), thickness_m=math.inf
    )
    middle = contact.pressure_pa[rows // 2 - 8 : rows // 2 + 8].mean(0)
    force_per_m = middle.sum() * pixel_m
    peak_pa = formulas.line_peak(force_per_m, RADIUS_M, REDUCED_PA)
    half_m = 2 * force_per_m / (math.pi * peak_pa)
    dense = np.linspace(-1, 1, 401)
    axes.plot(1e3 * half_m * dense, peak_pa / 1e3 * np.sqrt(1 - dense**2), **FORMULA)
    axes.plot(1e3 * x, middle / 1e3, **OURS)
    label(axes, "long cylinder, middle section: pressure", "mm", "kPa")
    return [row("cylinder: greatest pressure", "Hertz", peak_pa / 1e3, middle.max() / 1e3, "0.5 %")]


def draw_layer(axes: Any) -> list[Row]:
    """Draw the stiffness of a flat punch on the bonded layer over its radius."""
    rows = []
    dense, ratios = np.linspace(0.1, 2.2, 22), (0.2, 0.4, 1.0, 2.0)
    for poisson_ratio in (0.3, 0.45, 0.49, 0.4999):
        axes.plot(dense, [formulas.stiffness(ratio, poisson_ratio, 60) for ratio in dense], **FORMULA)
        unit = 4 * shear_pa(poisson_ratio) * LAYER_M * 1e-5 / (1 - poisson_ratio)
        computed = [punch_on_layer(ratio, poisson_ratio, 160) / (unit * ratio) for ratio in ratios]
        axes.plot(ratios, computed, **OURS)
        expected = formulas.stiffness(2.0, poisson_ratio)
        case = f"flat punch on the bonded layer, a/h = 2, nu = {poisson_ratio}: stiffness"
        rows.append(row(case, "Lebedev and Ufliand; Hayes", expected, computed[-1], "1 %"))
    label(axes, "flat punch on the layer, nu = 0.3 ... 0.4999", "a / h", "P (1 - nu) / (4 G a d)")
    return rows


def thin_layer_force_n(ratio: Any, poisson_ratio: float, depth_m: float) -> Any:
    """Return the force on a flat punch for a >> h: Johnson, 5.70; of squeeze flow for nu near 0.5: 5.8."""
    shear = shear_pa(poisson_ratio)
    if poisson_ratio > 0.49:
        return 3 * math.pi * shear * depth_m * LAYER_M * ratio**4 / 8
    confined_pa = 2 * shear * (1 - poisson_ratio) / (1 - 2 * poisson_ratio)
    return confined_pa * math.pi * ratio**2 * LAYER_M * depth_m


def draw_thin_layers(axes: Any) -> list[Row]:
    """Draw the force on a thin layer, relative to its limits."""
    rows = []
    ratios = np.array([3.0, 4.0, 5.0, 6.0, 8.0])
    dense = np.linspace(2.5, 8.5, 13)
    for poisson_ratio, at, within in ((0.4999, 5.0, "2 %"), (0.3, 4.0, "1 %")):
        unit = 4 * shear_pa(poisson_ratio) * LAYER_M * 1e-5 / (1 - poisson_ratio)
        limit = partial(thin_layer_force_n, poisson_ratio=poisson_ratio, depth_m=1e-5)
        exact = [formulas.stiffness(ratio, poisson_ratio) * unit * ratio for ratio in dense]
        axes.plot(dense, np.array(exact) / limit(dense), **FORMULA)
        computed = np.array([punch_on_layer(ratio, poisson_ratio, 160) for ratio in ratios]) / limit(ratios)
        axes.plot(ratios, computed, **OURS)
        expected = formulas.stiffness(at, poisson_ratio) * unit * at / limit(at)
        case = f"thin layer, a/h = {at:g}, nu = {poisson_ratio}: force over its limit"
        at_ratio = computed[list(ratios).index(at)]
        rows.append(row(case, "thin layers; Fredholm's equation", expected, at_ratio, within))
    label(axes, "thin layer, nu = 0.4999 and 0.3: force / limit", "a / h", "")
    return rows


def on_a_sphere(count: int, **motion: Any) -> tuple[tactile_sim.ElasticContact, float, float]:
    """Slide or twist a pressed sphere; return the contact, its radius and the size of a pixel, metres."""
    gel = tactile_sim.Gel(E_PA, 0.5, FRICTION)
    contact_m = (3 * FORCE_N * RADIUS_M * (1 - 0.25) / (4 * E_PA)) ** (1 / 3)
    pixel_m = 2.4 * contact_m / count
    heights = sphere(count, pixel_m, RADIUS_M)
    contact = tactile_sim.solve_contact(
        heights, pixel_m, GelLoad(force_n=FORCE_N, gel=gel, **motion), thickness_m=math.inf
    )
    return contact, contact_m, pixel_m


def draw_slide(axes: Any) -> list[Row]:
    """Draw force and stick radius over the slide of a sphere."""
    shear = shear_pa(0.5)
    contact_m = on_a_sphere(32)[1]
    dense = 1 - np.linspace(1, 0, 101) ** 3  # the last pixels slip all at once
    slides, inner = formulas.mindlin_slide(dense, FRICTION, FORCE_N, contact_m, shear, 0.5)
    axes.plot(1e6 * slides, dense, **FORMULA)
    axes.plot(1e6 * slides, inner, **FORMULA)
    computed = []
    shares = np.array([0.1, 0.3, 0.5, 0.7, 0.9])
    slides, inner = formulas.mindlin_slide(shares, FRICTION, FORCE_N, contact_m, shear, 0.5)
    for slide_m in slides:
        contact, _, pixel_m = on_a_sphere(192, slide_m=(float(slide_m), 0.0))
        computed.append(
            (contact.force_n[0] / (FRICTION * FORCE_N), area_radius_m(contact.is_stick, pixel_m) / contact_m)
        )
    forces, sticks = np.transpose(computed)
    axes.plot(1e6 * slides, forces, **OURS)
    axes.plot(1e6 * slides, sticks, **OURS)
    label(axes, "slide of a sphere: force / (mu P), and c / a", "um", "")
    return [
        row("slide of a sphere: force / (mu P)", "Cattaneo and Mindlin", shares[2], forces[2], "1 %"),
        row("slide of a sphere: c/a", "Cattaneo and Mindlin", inner[2], sticks[2], "2 %"),
    ]


def draw_twist(axes: Any) -> list[Row]:
    """Draw torque and stick radius over the twist of a sphere."""
    shear = shear_pa(0.5)
    contact_m = on_a_sphere(32)[1]
    full_n_m = 3 * math.pi * FRICTION * FORCE_N * contact_m / 16

    def twist_and_torque(inner: float) -> tuple[float, float]:
        return formulas.lubkin(inner, FRICTION, FORCE_N, contact_m, shear)

    dense = np.linspace(0.05, 0.999, 100)
    twists, torques = np.transpose([twist_and_torque(inner) for inner in dense])
    axes.plot(np.degrees(twists), torques / full_n_m, **FORMULA)
    axes.plot(np.degrees(twists), dense, **FORMULA)
    ratios = (0.9, 0.8, 0.7, 0.6, 0.5, 0.2)
    twists, torques = np.transpose([twist_and_torque(inner) for inner in ratios])
    computed = []
    for twist in twists:
        contact, _, pixel_m = on_a_sphere(128, twist_rad=float(twist))
        stick_m = area_radius_m(contact.is_stick, pixel_m)
        computed.append((contact.torque_n_m[2] / full_n_m, stick_m / contact_m))
    torque_ratios, sticks = np.transpose(computed)
    axes.plot(np.degrees(twists), torque_ratios, **OURS)
    axes.plot(np.degrees(twists[:5]), sticks[:5], **OURS)
    label(axes, "twist of a sphere: torque / full slip, and c / a", "degrees", "")
    return [
        row(
            "twist of a sphere: torque over that of full slip",
            "Lubkin",
            torques[3] / full_n_m,
            torque_ratios[3],
            "1 %",
        ),
        row("twist of a sphere: c/a", "Lubkin", ratios[3], sticks[3], "2 %"),
    ]


def draw_elements(axes: Any) -> list[Row]:
    """Draw the surface under a patch of a digit, along the row of pixels that bends most."""
    rows = []
    compliance = elements.patch_compliance()
    for friction, words in ((0.0, "without friction"), (1000.0, "stuck")):
        for patch in elements.PATCHES:
            heights = elements.patch_heights(*patch)
            gel = tactile_sim.Gel(elements.E_PA, elements.POISSON, friction)
            contact = tactile_sim.solve_contact(
                heights,
                elements.PIXEL_M,
                GelLoad(depth_m=elements.DEPTH_M, gel=gel),
                thickness_m=elements.LAYER_M,
            )
            target = (elements.DEPTH_M - (heights.max() - heights)).ravel()
            force_n, sunk_m = elements.elements(compliance, target, friction > 0)
            case = f"digit {patch[0]}, {words}: force"
            rows.append(row(case, "finite elements", force_n, contact.force_n[2], "2 %"))
            if patch == elements.PATCHES[0] and friction == 0:
                line = int(contact.displacement_m[..., 2].std(1).argmax())
                x = 1e3 * elements.PIXEL_M * np.arange(elements.COUNT)
                axes.plot(x, 1e3 * sunk_m.reshape(heights.shape)[line], **FORMULA)
                axes.plot(x, 1e3 * contact.displacement_m[line, :, 2], **OURS)
    label(axes, "under a digit: finite elements and here", "mm", "mm deep")
    return rows


if __name__ == "__main__":
    main()
