"""``python -m dosplan`` is ``dosplan``."""

from __future__ import annotations

import sys

from dosplan.cli.main import main

if __name__ == "__main__":
    sys.exit(main())
