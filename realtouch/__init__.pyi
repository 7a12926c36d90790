"""The public names of this package; type checkers read this list, and each name is imported on first use."""

from .touch_options import Alignment as Alignment, CheckLimits as CheckLimits
from .contact_picture import (
    ContactRule as ContactRule,
    ContactScore as ContactScore,
    contact_score as contact_score,
    difference as difference,
)
from .contacts import (
    Contacts as Contacts,
    background as background,
    best_frame as best_frame,
    contacts_by_image as contacts_by_image,
)
from .convert.conversion import Source as Source
from .convert.media_conversions import (
    clips_to_images as clips_to_images,
    resize as resize,
)
from .convert.picture_files import frames as frames
from .convert.reading_depth import add_depth as add_depth
from .convert.selection import select as select
from .finding import RecordingFinding as RecordingFinding
from .faults.check_results import CheckResult as CheckResult
from .faults.checking import check as check
from .depth_maps import DepthMaps as DepthMaps
from .formats.exporting import export as export
from .importing.import_preview import ImportPreview as ImportPreview, preview_import as preview_import
from .importing.import_shards import NOT_IMPORTED as NOT_IMPORTED
from .importing.touch_import import CONVERSION as CONVERSION, import_touches as import_touches
from .opening import SHORT_NAMES as SHORT_NAMES, load as load
from .poses import Poses as Poses, PoseSequences as PoseSequences
from .rounds import (
    TouchRound as TouchRound,
    TouchSeqRound as TouchSeqRound,
    TouchSingleRound as TouchSingleRound,
)
from .summary import (
    Summary as Summary,
    paper_numbers as paper_numbers,
    summarise as summarise,
)
from .touch import Touch as Touch
from .touch_clips import TouchClip as TouchClip
from .touch_dataset import (
    TouchDataset as TouchDataset,
    TouchSeqDataset as TouchSeqDataset,
    TouchSingleDataset as TouchSingleDataset,
    TouchStream as TouchStream,
    dataset_of as dataset_of,
)
from .importing.import_columns import ImportColumns as ImportColumns
from .touches import Touches as Touches
from .verification import TouchVerification as TouchVerification, verify as verify

__version__: str
