"""Real touches: typed, lazy, fast loaders."""
