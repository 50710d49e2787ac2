"""SUMO in this process, in which it can run once at a time.

``libsumo`` is SUMO as a library: it needs no program and no port, and holds one simulation.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from types import ModuleType
from typing import Any, Final

from dosplan.system.errors import DosplanError

_ALWAYS: Final = {
    # Nobody vanishes or leaps, whatever happens.
    "collision.action": "none",
    "time-to-teleport": "-1",
    "no-step-log": "true",
    "no-warnings": "true",
    "duration-log.disable": "true",
    "xml-validation": "never",
    "xml-validation.net": "never",
}
_LOG: Final = "errors.txt"
_MANY: Final = 300
"""Characters of a message of SUMO that are shown."""
_running: Simulation | None = None


class SumoError(DosplanError, RuntimeError):
    """SUMO is not there, or cannot go on; the message is one line."""


def library() -> ModuleType:
    """SUMO as a library.

    Returns:
        The module.

    Raises:
        SumoError: It is not installed.
    """
    try:
        import libsumo
    except ImportError as error:
        raise SumoError(f"SUMO is not there ({error}); pip install 'dosplan[sumo]'") from None
    return libsumo  # type: ignore[no-any-return]


class Simulation:
    """A simulation, until it is closed.

    Attributes:
        sumo: The library, for what is not here.
    """

    def __init__(
        self,
        net: Path,
        demand: Sequence[Path],
        step_seconds: float,
        options: Mapping[str, str],
        folder: Path,
    ) -> None:
        """Starts SUMO.

        Args:
            net: The network.
            demand: The demand; those files first of which others use something.
            step_seconds: Length of a step, s.
            options: Options of SUMO.
            folder: Where SUMO writes its messages.

        Raises:
            SumoError: Another simulation runs in this process, or SUMO refuses its files.
        """
        global _running
        self.sumo: Any = library()
        if _running is not None or self.sumo.isLoaded():
            raise SumoError(
                "another simulation of SUMO runs in this process, which can hold one: close its "
                "traffic first, or drive in several processes (--workers)"
            )
        self._log = folder / _LOG
        routes = [str(path) for path in demand if path.name.endswith(".rou.xml")]
        more = [str(path) for path in demand if not path.name.endswith(".rou.xml")]
        chosen = {
            **options,
            **_ALWAYS,
            "net-file": str(net),
            "route-files": ",".join(routes),
            "step-length": f"{step_seconds:g}",
            "error-log": str(self._log),
            **({"additional-files": ",".join(more)} if more else {}),
        }
        _running = self
        try:
            with self.failures():
                self.sumo.start(["sumo", *(f"--{name}={value}" for name, value in chosen.items())])
        except BaseException:
            self.close()
            raise

    @property
    def time(self) -> float:
        """SUMO's time of the state that is shown, s, as its own recordings count it.

        (In SUMO's interface it is the time at which the next step begins, a step later.)
        """
        return float(self.sumo.simulation.getTime()) - float(self.sumo.simulation.getDeltaT())

    def step(self) -> None:
        """Drives a step.

        Raises:
            SumoError: SUMO cannot go on.
        """
        with self.failures():
            self.sumo.simulationStep()

    def close(self) -> None:
        """Ends SUMO; nothing happens where it has ended."""
        global _running
        if _running is self:
            _running = None
            if self.sumo.isLoaded():
                self.sumo.close()

    @contextmanager
    def failures(self) -> Iterator[None]:
        """Turns what SUMO raises into one line."""
        try:
            yield
        except (self.sumo.TraCIException, self.sumo.FatalTraCIError) as error:
            logged = self._log.read_text(errors="replace") if self._log.is_file() else ""
            text = " ".join((logged or str(error)).split())
            raise SumoError(f"SUMO: {text[:_MANY]}") from None
