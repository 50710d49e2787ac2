"""Pages that people look at: ``report.html`` of a run, and that of a comparison."""
