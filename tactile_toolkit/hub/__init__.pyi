"""The public names of this package; type checkers read this list, and each name is imported on first use."""

from .repository import (
    HubRepository as HubRepository,
    hub_name as hub_name,
    open_repository as open_repository,
)
