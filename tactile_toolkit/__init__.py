"""What a data set is, whatever is in it: folder, shards, records, cards, the Hub, solids, touches."""

from tactile_toolkit.versions import toolkit_version

__all__ = ["__version__"]

__version__ = toolkit_version()
