"""From meshes to files that print: one per object, or packed on build plates.

::

    choose() -> PrintObject                            objects.py
       -> export_files(): one STL, 3MF, ... each       singles.py
       -> measure(): outlines and cells                layout.py, packing.py
       -> arrange(): what lies where                   layout.py, packing.py
       -> write_plates(): 3MF, map, table              plates.py, plate_map.py

Whatever is written is read back from disk and has to be the same solid before it gets its name (checked.py).
"""
