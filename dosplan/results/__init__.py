"""The run folder: manifest, rows, recordings, and what is computed from them."""
