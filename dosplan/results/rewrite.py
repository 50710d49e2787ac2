"""Writes ``summary.json`` and ``summary.md`` of runs anew, from their rows.

``python -m dosplan.results.rewrite RUN ...`` is for runs of which the rows are kept and the episode
files are not, such as those in ``results/``, when a version computes more or better figures.
"""

from __future__ import annotations

import sys
from pathlib import Path

from dosplan.results.folder import RunFolder
from dosplan.results.markdown import summary_markdown
from dosplan.results.rows import read_run
from dosplan.results.summary import summarise_rows, write_summary
from dosplan.system.files import write_text


def rewrite_summary(path: Path) -> None:
    """Writes the summary of a run anew.

    Args:
        path: The run folder.

    Raises:
        FileError: It is not the folder of a finished run, or a file cannot be written.
    """
    folder = RunFolder(path)
    summary = summarise_rows(folder, *read_run(path))
    write_summary(folder, summary)
    write_text(folder.summary_text, summary_markdown(summary))


if __name__ == "__main__":
    for run in sys.argv[1:]:
        rewrite_summary(Path(run))
