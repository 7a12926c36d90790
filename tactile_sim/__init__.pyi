"""The public names of this package; type checkers read this list, and each name is imported on first use."""

from .generation import GenerateSpec as GenerateSpec, generate as generate
from .touch_table import TouchTable as TouchTable
from .noise import SensorNoise as SensorNoise
from .optics import make_optics as make_optics
from .plan import RoundPlan as RoundPlan, plan_round as plan_round
from .pressing import pose as pose
from .pressing import Pressable as Pressable, Pressed as Pressed, render_touch as render_touch
from .pressing import Sensor as Sensor, center_view as center_view, full_view as full_view
from .spec import TouchPlan as TouchPlan
from .generation import TouchMaking as TouchMaking, look as look
from .pairs import PairsMaking as PairsMaking

__version__: str
