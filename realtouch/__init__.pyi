"""The public names: type checkers read this list, and the package imports each on first use."""

from realtouch.convert.api import (
    frames as frames,
    resize as resize,
    select as select,
    clips_to_images as clips_to_images,
)
from realtouch.dataset import (
    TouchDataset as TouchDataset,
    TouchSeqDataset as TouchSeqDataset,
    TouchSingleDataset as TouchSingleDataset,
    TouchStream as TouchStream,
)
from realtouch.exchange.api import export as export
from realtouch.exchange.api import import_images as import_images
from realtouch.spec import ImportColumns as ImportColumns
from realtouch.verification import verify as verify
from realtouch.media import TouchClip as TouchClip
from realtouch.opening import SHORT_NAMES as SHORT_NAMES
from realtouch.opening import load as load
from realtouch.poses import Poses as Poses, PoseSequences as PoseSequences
from realtouch.preprocess import (
    Contacts as Contacts,
    background as background,
    best_frame as best_frame,
    contacts_by_image as contacts_by_image,
)
from realtouch.contact import difference as difference
from realtouch.contact import contact_score as contact_score
from realtouch.contact import ContactScore as ContactScore
from realtouch.contact import ContactRule as ContactRule
from realtouch.rounds import (
    TouchRound as TouchRound,
    TouchSeqRound as TouchSeqRound,
    TouchSingleRound as TouchSingleRound,
)
from realtouch.summary import Summary as Summary, summarise as summarise
from realtouch.rounds import Touch as Touch
from realtouch.dataset import Touches as Touches

__version__: str
