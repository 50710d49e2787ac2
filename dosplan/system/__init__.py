"""Files, processes, versions and errors: what has nothing to do with driving."""
