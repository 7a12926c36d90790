"""From meshes to files that print: one per object, or packed on build plates.

::

    choose() -> PrintObject -> export_files(): one STL, 3MF, ... each    objects.py
       -> measure(), arrange(): what lies where on plates                packing.py
       -> write_plates(): 3MF, map, table                                plates.py

Whatever is written is read back from disk and has to be the same solid before it gets its name (objects.py).
"""

from lazy_loader import attach_stub

__getattr__, __dir__, __all__ = attach_stub(__name__, __file__)
