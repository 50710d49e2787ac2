"""The optimal control problem as machine code: libraries in the cache, made by a C compiler.

CasADi evaluates a problem in a virtual machine. The same problem, written out as C and compiled,
gives the same iterates to the last bit in about half the time. A compiler takes minutes for what
the virtual machine is ready for in half a second, so ``dosplan compile`` makes libraries once; the
planner uses a library that is there and never needs a compiler itself.

A library is named by a SHA-256 over the problem as CasADi serialises it: a setting that changes the
problem changes the name, and the library of the old problem is not loaded any more. The digest of
its content lies beside it, because loading an incomplete library kills the process.
"""

from __future__ import annotations

import contextlib
import os
import platform
import shlex
import shutil
import subprocess
import warnings
from dataclasses import dataclass
from hashlib import sha256
from importlib.metadata import version
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, Final

import casadi as ca

from dosplan.system.errors import DosplanError
from dosplan.system.files import write_bytes, write_text
from dosplan.system.folders import cache_folder

_NAME: Final = "mpc"
_SOLVER: Final = "fatrop"
_COMPILERS: Final = ("cc", "gcc", "clang")
# More optimisation takes far longer and gains nothing; a fused multiply-add rounds differently.
_FLAGS: Final = ("-O1", "-fPIC", "-shared", "-ffp-contract=off")


class CompileError(DosplanError, RuntimeError):
    """A problem that cannot be compiled here; one line."""


@dataclass(frozen=True)
class Formulation:
    """A problem as CasADi takes it.

    Attributes:
        graph: Expressions of the decision ``x``, the parameter ``p``, the cost ``f`` and the
            constraints ``g``.
        options: Of CasADi's ``nlpsol``.
    """

    graph: dict[str, Any]
    options: dict[str, Any]

    def library(self) -> Path:
        """Where the library of this problem is, if there is one.

        Returns:
            A path in the cache; problems, versions of CasADi and kinds of machines that differ
            have different ones.
        """
        problem = ca.Function(
            _NAME, [self.graph["x"], self.graph["p"]], [self.graph["f"], self.graph["g"]]
        )
        made_for = (version("casadi"), platform.system(), platform.machine(), *_FLAGS)
        key = sha256("\n".join((*made_for, problem.serialize())).encode())
        return cache_folder() / "mpc" / f"{key.hexdigest()}.so"

    def solver(self) -> Any:
        """Makes the solver: of the library where there is one, or else of the virtual machine.

        Returns:
            CasADi's solver.

        Warns:
            UserWarning: There is a library, but it is damaged or not one of this machine.
        """
        path = self.library()
        if _digest_file(path).exists():
            with contextlib.suppress(RuntimeError):  # Raised where it cannot be loaded.
                if is_whole(path):
                    return ca.nlpsol(_NAME, _SOLVER, str(path), self.options)
            warnings.warn(
                f"{path} cannot be loaded and is not used; `dosplan compile --force` makes it anew",
                stacklevel=2,
            )
        return self._virtual_machine()

    def compile(self, path: Path) -> None:
        """Writes the problem as C, compiles that and puts the library into place.

        Args:
            path: Where, as of ``library``.

        Raises:
            CompileError: There is no compiler, or it fails.
            FileError: The library cannot be written.
        """
        compiler = _compiler()
        with TemporaryDirectory() as folder:
            with contextlib.chdir(folder):  # CasADi takes a name without a folder only.
                source = self._virtual_machine().generate_dependencies(f"{_NAME}.c")
            library = Path(folder, path.name)
            command = [*compiler, *_FLAGS, "-o", str(library), str(Path(folder, source)), "-lm"]
            try:
                subprocess.run(command, check=True, capture_output=True, text=True)  # noqa: S603
            except OSError as error:
                raise CompileError(f"cannot run {compiler[0]}: {error.strerror}") from None
            except subprocess.CalledProcessError as error:
                lines = error.stderr.splitlines() or [f"exit code {error.returncode}"]
                first_error = min(lines, key=lambda line: "error" not in line)
                raise CompileError(f"{shlex.join(compiler)} failed: {first_error}") from None
            data = library.read_bytes()
        # Until the digest is written, another process finds a library without one and ignores it.
        _digest_file(path).unlink(missing_ok=True)
        write_bytes(path, data)
        write_text(_digest_file(path), sha256(data).hexdigest())

    def _virtual_machine(self) -> Any:
        return ca.nlpsol(_NAME, _SOLVER, self.graph, self.options)


def is_whole(path: Path) -> bool:
    """Whether a library is there and undamaged.

    Args:
        path: The library.

    Returns:
        Whether its content has the digest that was written with it.
    """
    try:
        return sha256(path.read_bytes()).hexdigest() == _digest_file(path).read_text("ascii")
    except (OSError, ValueError):
        return False


def _digest_file(path: Path) -> Path:
    return path.with_suffix(".sha256")


def _compiler() -> list[str]:
    """The compiler and the arguments that come with it."""
    chosen = shlex.split(os.environ.get("CC", "")) or [c for c in _COMPILERS if shutil.which(c)][:1]
    if not chosen or shutil.which(chosen[0]) is None:
        wanted = " ".join(chosen) or ", ".join(_COMPILERS)
        raise CompileError(f"no C compiler ({wanted}): install one, or name it in $CC")
    return chosen
