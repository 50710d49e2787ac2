"""Files, processes, versions and errors: all that is not about driving."""
