"""The public names of this package; type checkers read this list, and each name is imported on first use."""

from .calls import (
    call_with_retry as call_with_retry,
    hub_failures as hub_failures,
    not_cached as not_cached,
    page_of as page_of,
)
from .repository import (
    HubName as HubName,
    HubRepository as HubRepository,
    find_cached as find_cached,
    hub_name as hub_name,
    listing as listing,
    open_repository as open_repository,
)
