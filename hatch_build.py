"""The long description for the package index: the README, which stands alone there."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any, Final

from hatchling.metadata.plugin.interface import MetadataHookInterface

_LINK: Final = re.compile(
    r"(?P<image>!?)\[(?P<text>[^\]]*)\]\((?!https?:|mailto:)(?P<to>[^)\s]+)\)"
)
_FENCE: Final = re.compile(r"(^```.*?^```$)", re.MULTILINE | re.DOTALL)


class LongDescription(MetadataHookInterface):
    """Takes the README as the long description."""

    def update(self, metadata: dict[str, Any]) -> None:
        """Sets ``readme``.

        Args:
            metadata: The table ``project`` of pyproject.toml.
        """
        text = Path(self.root, "README.md").read_text(encoding="utf-8")
        repository = metadata["urls"]["Repository"]
        readme = {"content-type": "text/markdown", "text": with_whole_links(text, repository)}
        metadata["readme"] = readme


def with_whole_links(text: str, repository: str) -> str:
    """Makes links and pictures of a page of the repository work anywhere.

    Args:
        text: The page, which lies in the repository's root.
        repository: Address of the repository on GitHub.

    Returns:
        The page; what stands in code blocks is as it was.
    """

    def whole(link: re.Match[str]) -> str:
        to = link["to"]
        if not to.startswith("#"):  # A part of the page itself is that of the repository's page.
            to = f"/{'raw' if link['image'] else 'blob'}/main/{to}"
        return f"{link['image']}[{link['text']}]({repository}{to})"

    parts = _FENCE.split(text)
    parts[::2] = [_LINK.sub(whole, part) for part in parts[::2]]
    return "".join(parts)
