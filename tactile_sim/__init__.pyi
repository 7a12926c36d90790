"""The public names of this package; type checkers read this list, and each name is imported on first use."""

from .elastic.contact import Contact as Contact, Gel as Gel, solve_contact as solve_contact
from .elastic_press import fit_youngs_modulus as fit_youngs_modulus
from .generation import TouchGenerator as TouchGenerator, generate as generate
from .markers import marker_grid_px as marker_grid_px, marker_positions_px as marker_positions_px
from .optics import make_optics as make_optics
from .pair_generation import PairsGenerator as PairsGenerator, make_pairs as make_pairs
from .learning_specs import PairsSpec as PairsSpec, TrainConfig as TrainConfig
from .poses import pose as pose
from .press_spec import ElasticPress as ElasticPress
from .pressable import Pressable as Pressable
from .pressing import Pressed as Pressed, render_touch as render_touch
from .round_plan import RoundPlan as RoundPlan, plan_round as plan_round
from .sensor import Sensor as Sensor, center_view as center_view, full_view as full_view
from .sensor_health import (
    SensorHealth as SensorHealth,
    check_sensor as check_sensor,
    images_of as images_of,
)
from .sensor_models import SENSORS as SENSORS, SensorModel as SensorModel
from .sensor_noise import SensorNoise as SensorNoise
from .touch_preview import TouchPreview as TouchPreview, preview_touch as preview_touch
from .touch_rows import SyntheticRound as SyntheticRound, synthetic_schema as synthetic_schema
from .touch_spec import (
    SENSOR_NOISE as SENSOR_NOISE,
    GenerateSpec as GenerateSpec,
    TouchPlan as TouchPlan,
    default_optics as default_optics,
)
from .touch_table import TouchTable as TouchTable
from .twin.calibration import calibrate as calibrate
from .twin.mistakes import Mistake as Mistake, find_mistakes as find_mistakes
from .sensor_parts import DepthReading as DepthReading
from .twin.recordings import Recordings as Recordings
from .twin.sources import read_recordings as read_recordings

__version__: str
