"""Synthetic touches: any solid, pressed by a simulated GelSight Mini.

``tactile_sim.press`` gives depth, ``tactile_sim.generate`` writes a data set, which ``realtouch.load`` opens.
Names are imported on first use, so that ``import tactile_sim`` costs nothing.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from tactile_toolkit.lazy_names import on_first_use

if TYPE_CHECKING:
    from tactile_sim.generation import GenerateSpec, generate
    from tactile_sim.given import GivenTouches
    from tactile_sim.noise import SensorNoise
    from tactile_sim.optics import make_optics
    from tactile_sim.plan import RoundPlan, plan_round
    from tactile_sim.poses import pose
    from tactile_sim.pressing import Pressable, Pressed, press
    from tactile_sim.sensor import Sensor, as_environment, as_sensor
    from tactile_sim.spec import TouchPlan

__all__ = [
    "GenerateSpec",
    "GivenTouches",
    "Pressable",
    "Pressed",
    "RoundPlan",
    "Sensor",
    "SensorNoise",
    "TouchPlan",
    "as_environment",
    "as_sensor",
    "generate",
    "make_optics",
    "plan_round",
    "pose",
    "press",
]

__version__: str

__getattr__, __dir__ = on_first_use(
    __name__,
    {
        "tactile_sim.generation": ("GenerateSpec", "generate"),
        "tactile_sim.given": ("GivenTouches",),
        "tactile_sim.noise": ("SensorNoise",),
        "tactile_sim.optics": ("make_optics",),
        "tactile_sim.plan": ("RoundPlan", "plan_round"),
        "tactile_sim.poses": ("pose",),
        "tactile_sim.pressing": ("Pressable", "Pressed", "press"),
        "tactile_sim.spec": ("TouchPlan",),
        "tactile_sim.sensor": ("Sensor", "as_environment", "as_sensor"),
    },
)
