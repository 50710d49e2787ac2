"""Third-party planners behind dosplan's interface, used as in their own run scripts.

They need the extra ``peers``; nothing of it is imported before one of them is named.
"""

from __future__ import annotations

from typing import Final

INSTALL: Final = "pip install 'dosplan[peers]' in Python 3.11"
"""What to do where a peer is not installed."""
