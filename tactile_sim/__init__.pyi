"""The public names: type checkers read this list, and the package imports each on first use."""

from tactile_sim.generation import GenerateSpec as GenerateSpec, generate as generate
from tactile_sim.given import GivenTouches as GivenTouches
from tactile_sim.noise import SensorNoise as SensorNoise
from tactile_sim.optics import make_optics as make_optics
from tactile_sim.plan import RoundPlan as RoundPlan, plan_round as plan_round
from tactile_sim.sensor import pose as pose
from tactile_sim.pressing import Pressable as Pressable, Pressed as Pressed, press as press
from tactile_sim.sensor import Sensor as Sensor, as_environment as as_environment, as_sensor as as_sensor
from tactile_sim.spec import TouchPlan as TouchPlan

__version__: str
