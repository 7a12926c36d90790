"""Files for printers, from meshes: one for each object, or build plates of several objects.

::

    choose() -> PrintObject -> export_files(): one STL, 3MF, ... each    objects.py, single_files.py
       -> arrange(): positions on plates                                 packing.py
       -> write_plates(): 3MF, map, table                                plates.py, plate_map.py

Each file is read back from disk and has to be the same solid before it gets its name (file_export.py).
"""

from lazy_loader import attach_stub

__getattr__, __dir__, __all__ = attach_stub(__name__, __file__)
