"""The public names of this package; type checkers read this list, and each name is imported on first use."""

from .convert.api import (
    frames as frames,
    resize as resize,
    select as select,
    clips_to_images as clips_to_images,
)
from .dataset import (
    TouchDataset as TouchDataset,
    TouchSeqDataset as TouchSeqDataset,
    TouchSingleDataset as TouchSingleDataset,
    TouchStream as TouchStream,
)
from .exchange.api import export as export
from .exchange.api import CONVERSION as CONVERSION, NOT_IMPORTED as NOT_IMPORTED
from .exchange.api import import_images as import_images
from .spec import ImportColumns as ImportColumns
from .verification import verify as verify
from .media import TouchClip as TouchClip
from .opening import SHORT_NAMES as SHORT_NAMES
from .opening import load as load
from .poses import Poses as Poses, PoseSequences as PoseSequences
from .preprocess import (
    Contacts as Contacts,
    background as background,
    best_frame as best_frame,
    contacts_by_image as contacts_by_image,
)
from .contact import difference as difference
from .contact import contact_score as contact_score
from .contact import ContactScore as ContactScore
from .contact import ContactRule as ContactRule
from .rounds import (
    TouchRound as TouchRound,
    TouchSeqRound as TouchSeqRound,
    TouchSingleRound as TouchSingleRound,
)
from .summary import Summary as Summary, summarise as summarise
from .rounds import Touch as Touch
from .dataset import Touches as Touches
from .convert.plan import Source as Source
from .dataset import dataset_of as dataset_of
from .summary import paper_numbers as paper_numbers
from .verification import TouchVerification as TouchVerification

__version__: str
