"""The parts of data sets that do not depend on their content; ``docs/architecture.md`` lists their layers.

Each package imports its public names on first use, by ``lazy_loader`` from the stub next to its
``__init__.py``. So importing a package costs nothing, and no import closes a circle.
"""

__version__ = "0.1.0"
