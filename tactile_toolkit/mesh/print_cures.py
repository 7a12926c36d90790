"""Meanings of the print warnings, and advice on each."""

from __future__ import annotations

from collections.abc import Iterable

from tactile_toolkit.mesh.print_profile import PrintProfile
from tactile_toolkit.mesh.print_report import WARNINGS, PrintReport
from tactile_toolkit.wording import with_count

WARNINGS_PAGE = "docs/warnings.md"
"""Page with a section on each warning."""

_CURES = {
    "thin-wall": "make it larger, draw with a thicker pen, or give it upright sides (--edge-profile flat)",
    "separate-bodies": "join the parts by a plate (--base-mm 2 of `mnist3d export` and `solidify`) or by "
    "bridges, or print them one by one",
    "overhang": "print with support, or put it on a plate (--base-mm 2 of `mnist3d export` and `solidify`)",
    "small-contact": "put it on a plate (--base-mm 2 of `mnist3d export` and `solidify`), or print it with a "
    "brim of 5 mm",
    "larger-than-plate": "make it smaller, or cut it in the slicer",
    "too-tall": "make it smaller, or lay it down in the slicer",
}


def print_advice(words: Iterable[str]) -> tuple[str, ...]:
    """Return a line for each warning: what to do, and the section that explains it."""
    given = set(words)
    return tuple(f"{word}: {_CURES[word]} (see {WARNINGS_PAGE}#{word})" for word in WARNINGS if word in given)


def explained(report: PrintReport, profile: PrintProfile) -> tuple[str, ...]:
    """Return a line for each warning of a report: what was found, what was expected, and what to do."""
    width, depth, height = report.size_mm
    plate = " x ".join(f"{side:g}" for side in profile.plate_mm)
    found = {
        "thin-wall": f"the thinnest wall is {report.thinnest_wall_mm:.2f} mm, expected "
        f"{profile.min_wall_mm:g} mm or more",
        "separate-bodies": f"there are {with_count(report.bodies, 'parts')} that print apart",
        "overhang": f"{report.overhang_mm2:,.0f} mm² lean out by more than {profile.overhang_deg:g} degrees",
        "small-contact": f"{report.contact_mm2:.1f} mm² lie on the plate of the printer, expected "
        f"{profile.min_contact_mm2:g} mm² or more",
        "larger-than-plate": f"it is {width:.1f} x {depth:.1f} mm, larger than the plate of {plate} mm",
        "too-tall": f"it is {height:.1f} mm tall, expected {profile.max_height_mm:g} mm at most",
    }
    return tuple(
        f"{word}: {found[word]}; next: {advice.removeprefix(f'{word}: ')}"
        for word, advice in zip(report.warnings, print_advice(report.warnings), strict=True)
    )
