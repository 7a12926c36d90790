"""Replay buffers of Diffusion Policy: groups of Zarr with the arrays ``tactile``, ``state``, ``action``."""

from __future__ import annotations

from realtouch.exchange.episodes import ACTION, STATE
from realtouch.exchange.zarr_groups import OUR_NAMES, GroupFormat

PIXELS = "tactile"

plan_replay = GroupFormat(
    name="replay buffer",
    folder="replay",
    pictures=PIXELS,
    arrays={**OUR_NAMES, STATE: "state", ACTION: "action"},
).plan
