"""Pictures without a screen: sheets, lettering, plots, shaded and oblique views, written whole."""
