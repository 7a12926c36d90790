"""Galleries: static pages that show a data set and open from a plain file system.

A room brings a :class:`~dataset_store.gallery.items.Gallery`, which says what its items are;
:func:`~dataset_store.gallery.site.build_site` makes the folder.
"""
