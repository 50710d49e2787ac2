"""Provenance of results: revision, versions and machine, for ``run.json``."""

from __future__ import annotations

import os
import platform
import subprocess
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from hashlib import file_digest, sha256
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Final

from dosplan import __version__

_PACKAGES: Final = (
    "casadi",
    "commonroad-io",
    "networkx",
    "numpy",
    "pebble",
    "python-fcl",
    "scipy",
    "shapely",
    "torch",
)


@dataclass(frozen=True)
class Machine:
    """A machine that figures come from.

    Attributes:
        platform: Its operating system.
        machine: Its processor's architecture.
        cpu_count: Number of its CPUs; null where it is not known.
    """

    platform: str
    machine: str
    cpu_count: int | None


@dataclass(frozen=True, kw_only=True)
class Environment:
    """What figures are made with.

    Attributes:
        versions: Versions of Python, dosplan and the packages that decide figures.
        git_revision: Commit of dosplan's own source, with ``-dirty`` where it was changed; None
            where it does not run from a checkout.
        machine: The machine.
    """

    versions: Mapping[str, str]
    git_revision: str | None
    machine: Machine


def describe_environment() -> Environment:
    """Describes what a run is made with.

    Returns:
        The versions and the machine of this process.
    """
    return Environment(
        versions={
            "python": platform.python_version(),
            "dosplan": __version__,
            **_package_versions(),
        },
        git_revision=git_revision(Path(__file__).parent),
        machine=Machine(
            platform=platform.platform(), machine=platform.machine(), cpu_count=os.cpu_count()
        ),
    )


def content_digest(paths: Iterable[Path]) -> str:
    """Fingerprints what files hold, whatever they are called.

    Args:
        paths: The files, in order.

    Returns:
        A SHA-256 over the size and SHA-256 of each; one that cannot be read has neither.
    """
    total = sha256()
    for path in paths:
        try:
            if not path.is_file():  # Reading a pipe or a device might never return.
                raise FileNotFoundError(path)
            with path.open("rb") as file:
                digest = file_digest(file, "sha256").hexdigest()
                size = file.tell()
        except OSError:
            total.update(b"unreadable\n")
        else:
            total.update(f"{size} {digest}\n".encode())
    return total.hexdigest()


def git_revision(source: Path) -> str | None:
    """Names the commit a folder of source stands at.

    Args:
        source: A folder with an ``__init__.py``.

    Returns:
        The commit's hash, with ``-dirty`` where tracked files are changed, or None where git is
        not there, has no commit, or does not track the folder (a wheel installed inside
        somebody's checkout is not of that checkout's revision).
    """
    if _git(source, "ls-files", "--error-unmatch", "__init__.py") is None:
        return None
    return _git(source, "describe", "--always", "--dirty", "--abbrev=40", "--exclude=*")


def _package_versions() -> dict[str, str]:
    versions = {}
    for package in _PACKAGES:
        try:
            versions[package] = version(package)
        except PackageNotFoundError:  # An optional one.
            continue
    return versions


def _git(folder: Path, *arguments: str) -> str | None:
    try:
        done = subprocess.run(  # noqa: S603 - fixed arguments
            ["git", "-C", str(folder), *arguments],  # noqa: S607 - the user's git
            capture_output=True,
            text=True,
            timeout=10,
            check=True,
        )
    except (OSError, subprocess.SubprocessError):
        return None
    return done.stdout.strip()
