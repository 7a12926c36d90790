"""The public names: type checkers read this list, and the package imports each on first use."""

from tactile_sim.generation import GenerateSpec as GenerateSpec, generate as generate
from tactile_sim.touch_table import TouchTable as TouchTable
from tactile_sim.noise import SensorNoise as SensorNoise
from tactile_sim.optics import make_optics as make_optics
from tactile_sim.plan import RoundPlan as RoundPlan, plan_round as plan_round
from tactile_sim.pressing import pose as pose
from tactile_sim.pressing import Pressable as Pressable, Pressed as Pressed, render_touch as render_touch
from tactile_sim.pressing import Sensor as Sensor, center_view as center_view, full_view as full_view
from tactile_sim.spec import TouchPlan as TouchPlan

__version__: str
