"""Galleries: static pages that show a data set and open from a plain file system.

A room brings a :class:`~tactile_toolkit.gallery.items.Gallery`, which says what its items are;
:func:`~tactile_toolkit.gallery.site.build_site` makes the folder.
"""
