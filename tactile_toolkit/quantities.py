"""Sizes, rates, durations and counts as text."""

from __future__ import annotations

from collections.abc import Sequence

BYTES = "bytes"
"""Unit of progress whose counts are shown as sizes."""


def rate_text(done: int, elapsed_s: float, unit: str) -> str:
    """Return a rate as text: ``"12 digits/s"``, ``"3.0 pictures/min"``."""
    rate, per = done / max(elapsed_s, 1e-9), "s"
    if unit == BYTES:
        return f"{bytes_text(rate)}/s"
    for longer in ("min", "h"):
        if rate < 1:
            rate, per = 60 * rate, longer
    # Two digits are enough, so there is no decimal from 9.95 on.
    digits = int(rate < 9.95)
    return f"{rate:,.{digits}f} {unit}/{per}"


def bytes_text(size: float) -> str:
    """Return a size as text: ``"12.3 MB"``."""
    if size < 999.5:
        return f"{size:.0f} B"
    for unit in ("kB", "MB"):
        size /= 1000
        if size < 999.95:  # larger sizes would round to 1000.0 and get the next unit
            return f"{size:.1f} {unit}"
    return f"{size / 1000:.1f} GB"


def duration_text(seconds: float) -> str:
    """Return a duration as text: ``"1 min 20 s"``."""
    minutes, rest = divmod(round(seconds), 60)
    if not minutes:
        return f"{rest} s"
    if minutes < 60:
        return f"{minutes} min {rest} s"
    return f"{minutes // 60} h {minutes % 60} min"


def least_to_most(counts: Sequence[int]) -> str:
    """Return the range of counts as text: ``"10"`` if all are equal, otherwise ``"8-10"``."""
    return "-".join(map(str, dict.fromkeys((min(counts), max(counts)))))
