"""Importing this module makes the readers of twins learn less, in this process and those that it forks.

For tests that run a calibration and do not look at the depth that is read: 10 s instead of 40 s.
"""

from __future__ import annotations

from tactile_sim.twin import reader

for _name, _value in (("_TOUCHES", 60), ("_SLOPE_STEPS", 200), ("_DEPTH_STEPS", 300)):
    setattr(reader, _name, _value)
