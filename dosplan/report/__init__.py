"""Reports of runs, for people: tables and progress."""
