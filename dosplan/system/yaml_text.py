"""Reads YAML of users: plain values, or one line that says why not.

Aliases are refused: a few lines of them can expand to more values than memory holds. So is deep
nesting, which recursive code cannot handle, and a key that is given twice, of which YAML would keep
the last.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any, Final

import yaml

from dosplan.system.errors import DosplanError

MAX_DEPTH: Final = 50
"""Levels of lists and mappings within each other."""


class YamlError(DosplanError, ValueError):
    """A text that is not YAML, or is more than plain values; the message is one line."""


def parse_yaml(text: str) -> Any:
    """Reads a YAML document.

    Args:
        text: The document.

    Returns:
        Its value: mappings, lists, texts, numbers, truth values, dates and None.

    Raises:
        YamlError: It is not such a document.
    """
    try:
        return yaml.load(text, _Loader)  # noqa: S506 - a safe loader, and stricter
    # Beside its own errors, PyYAML can raise others where a value does not fit its tag.
    except Exception as error:
        reason = str(error) if isinstance(error, yaml.YAMLError | ValueError) else repr(error)
        raise YamlError(f"is not YAML: {' '.join(reason.split())}") from None


def read_yaml(path: Path) -> Any:
    """Reads a YAML file.

    Args:
        path: The file.

    Returns:
        As of ``parse_yaml``.

    Raises:
        YamlError: It cannot be read or is not such a document; the message names the file.
    """
    try:
        return parse_yaml(path.read_text(encoding="utf-8"))
    except OSError as error:
        raise YamlError(f"cannot read {path}: {error.strerror or error}") from None
    except YamlError as error:
        raise YamlError(f"{path} {error}") from None
    except UnicodeDecodeError as error:
        raise YamlError(f"{path} is not YAML: {error}") from None


class _Loader(yaml.SafeLoader):  # type: ignore[misc]
    depth = 0

    def construct_mapping(self, node: Any, deep: bool = False) -> Any:
        known = set()
        for key, _ in node.value:
            name = getattr(key, "value", None)
            if not isinstance(name, str):
                continue
            if (key.tag, name) in known:
                raise yaml.constructor.ConstructorError(
                    None, None, f"{name!r} is given twice", key.start_mark
                )
            known.add((key.tag, name))
        return super().construct_mapping(node, deep)

    def compose_node(self, parent: Any, index: Any) -> Any:
        if self.check_event(yaml.AliasEvent):
            mark = self.peek_event().start_mark
            raise yaml.composer.ComposerError(None, None, "write aliases (*) out", mark)
        if self.depth == MAX_DEPTH:
            raise yaml.composer.ComposerError(None, None, "nested too deeply", None)
        self.depth += 1
        node = super().compose_node(parent, index)
        self.depth -= 1
        return node
