"""Wale-Net, a third-party predictor, behind dosplan's interface.

It needs the extra ``wale-net``; nothing of it is imported before it is named.
"""

from __future__ import annotations

from typing import Final

INSTALL: Final = "pip install 'dosplan[wale-net]'"
"""What to do where it is not installed."""
