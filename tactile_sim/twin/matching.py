"""Finds where touches without poses were: a grid of turns and places, by what is seen of the contact."""

from __future__ import annotations

import numpy as np

from tactile_sim.sensor_models import SensorModel
from tactile_sim.twin.recordings import Recordings
from tactile_toolkit.array_types import Bool, Float64


def matched_places(recordings: Recordings, start: SensorModel) -> tuple[Float64, Bool]:
    """Return points under the sensor with turns (N, 3), and which of them are likely (N,)."""
    raise NotImplementedError
