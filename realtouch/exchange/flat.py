"""Flat Parquet, for `datasets`, pandas and polars: the rows of touches, kept as they are."""

from __future__ import annotations

from realtouch.exchange.touches import plan_rows as plan

__all__ = ["plan"]
