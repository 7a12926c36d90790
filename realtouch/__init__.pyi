"""The public names of this package; type checkers read this list, and each name is imported on first use."""

from .touch_options import CheckLimits as CheckLimits
from .importing.import_options import (
    Alignment as Alignment,
    ImportColumns as ImportColumns,
    ImportSpec as ImportSpec,
)
from .contact import (
    ContactThresholds as ContactThresholds,
    ContactScore as ContactScore,
    contact_score as contact_score,
    difference as difference,
)
from .touches.image_contacts import (
    ImageContacts as ImageContacts,
    background as background,
    best_frame as best_frame,
    contacts_by_image as contacts_by_image,
)
from .convert.media_conversions import (
    add_depth as add_depth,
    clips_to_images as clips_to_images,
    resize as resize,
)
from .convert.selection import select as select
from .checks.rules import RecordingFinding as RecordingFinding
from .checks.checking import (
    check as check,
    CheckResult as CheckResult,
)
from .touches.media import (
    DepthMaps as DepthMaps,
    TouchClip as TouchClip,
)
from .formats.exports import export as export
from .importing.import_preview import ImportPreview as ImportPreview, preview_import as preview_import
from .importing.import_plan import import_touches as import_touches
from .touches.loading import SHORT_NAMES as SHORT_NAMES, load as load
from .touches.poses import Poses as Poses, PoseSequences as PoseSequences
from .touches.rounds import (
    Touch as Touch,
    TouchRound as TouchRound,
    TouchSeqRound as TouchSeqRound,
    TouchSingleRound as TouchSingleRound,
)
from .touches.loading import (
    Summary as Summary,
    paper_numbers as paper_numbers,
    summarise as summarise,
)
from .touches.datasets import (
    TouchDataset as TouchDataset,
    Touches as Touches,
    TouchMixedDataset as TouchMixedDataset,
    TouchSeqDataset as TouchSeqDataset,
    TouchSingleDataset as TouchSingleDataset,
    TouchStream as TouchStream,
)
from .checks.verification import TouchVerification as TouchVerification, verify as verify

__version__: str
