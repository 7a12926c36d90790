"""The public names of this package; type checkers read this list, and each name is imported on first use."""

from .elastic.contact import (
    ElasticContact as ElasticContact,
    Gel as Gel,
    GelLoad as GelLoad,
    solve_contact as solve_contact,
)
from .elastic.modulus import GelFit as GelFit, fit_youngs_modulus as fit_youngs_modulus
from .loop.bodies import Shape as Shape
from .loop.gel_state import GelState as GelState, GelWarning as GelWarning, press_at as press_at
from .press.elastic_press import (
    marker_grid_px as marker_grid_px,
    marker_positions_px as marker_positions_px,
)
from .sets.generation import (
    generate as generate,
    TouchGenerator as TouchGenerator,
)
from .sets.grasp_options import GraspSpec as GraspSpec
from .sets.grasps import GraspGenerator as GraspGenerator
from .optics.rendering import make_optics as make_optics
from .sets.pairs import PairGenerator as PairGenerator, make_pairs as make_pairs
from .sets.set_options import PairSetSpec as PairSetSpec, TrainConfig as TrainConfig, TrainRun as TrainRun
from .press.pressing import (
    pose as pose,
    Pressed as Pressed,
    render_touch as render_touch,
)
from .press.press_spec import ElasticPress as ElasticPress
from .press.pressable import Pressable as Pressable
from .sets.round_plan import plan_round as plan_round
from .press.sensors import (
    center_view as center_view,
    full_view as full_view,
    Sensor as Sensor,
    SensorModel as SensorModel,
    SENSORS as SENSORS,
)
from .twin.sensor_health import (
    SensorHealth as SensorHealth,
    check_sensor as check_sensor,
    images_of as images_of,
)
from .optics.sensor_noise import SensorNoise as SensorNoise
from .sets.round_press import TouchPreview as TouchPreview, preview_touch as preview_touch
from .sets.set_options import (
    TouchSetSpec as TouchSetSpec,
    TouchPlan as TouchPlan,
)
from .sets.touch_table import TouchTable as TouchTable
from .twin.calibration import calibrate as calibrate
from .twin.mistakes import Mistake as Mistake, find_mistakes as find_mistakes
from .twin.recordings import Recordings as Recordings
from .twin.sources import read_recordings as read_recordings

__version__: str
