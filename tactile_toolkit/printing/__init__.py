"""Files for printers, from meshes: one for each object, or build plates of several objects.

::

    export(): objects_of() -> PrintObject -> export_files(): one STL, 3MF, ... each    exports.py
       -> arrange(): positions on plates, and their maps                           plate_layouts.py
       -> write_plates(): 3MF, map, table                                          exports.py

Each file is read back from disk and has to be the same solid before it gets its name (file_export.py).
"""

from lazy_loader import attach_stub

__getattr__, __dir__, __all__ = attach_stub(__name__, __file__)
