"""The public names of this package; type checkers read this list, and each name is imported on first use."""

from .algorithm import solidify as solidify
from .literal import literal_solid as literal_solid
from .step_pictures import draw_steps as draw_steps
