"""What a data set is, whatever is in it; which part may import which is drawn in ``docs/architecture.md``.

Each package imports its public names on first use, by ``lazy_loader`` from the stub next to its
``__init__.py``. So importing a package costs nothing, and no import closes a circle.
"""

__version__ = "0.1.0"
