"""dosplan: a benchmark for motion planners under prediction uncertainty."""

from __future__ import annotations

__version__ = "0.2.0"
