"""Where the figures take their data from: the folder of published results."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np

from dosplan.results.folder import RunFolder
from dosplan.results.rows import read_run
from dosplan.system.files import FileError, read_json
from dosplan.types import FloatArray, Score

Z95: Final = 1.96  # Standard errors on each side of a 95 % interval.


@dataclass(frozen=True)
class Sets:
    """A method's sets in a group, at each of the T horizons.

    Attributes:
        horizon: (T,) s.
        coverage: (T,) CR, %.
        half: (T,) half the width of its 95 % interval, %; NaN with fewer than two recordings.
        area: (T,) OSA, m2; NaN where sets have no bounds.
    """

    horizon: FloatArray
    coverage: FloatArray
    half: FloatArray
    area: FloatArray


@dataclass(frozen=True)
class Evaluation:
    """What ``dosplan evaluate --json`` wrote.

    Attributes:
        path: The file.
        options: Options of each method, by its label, in the file's order.
        sets: The sets, by label and group.
        limits: (T,) upper limits, m2, by model, group and representation.
    """

    path: Path
    options: Mapping[str, Mapping[str, Any]]
    sets: Mapping[tuple[str, str], Sets]
    limits: Mapping[tuple[str, str, str], FloatArray]

    def of(self, label: str, group: str = "all") -> Sets:
        """A method's sets.

        Args:
            label: Label of the method.
            group: Group of windows.

        Returns:
            The sets.

        Raises:
            FileError: They were not evaluated.
        """
        if (label, group) not in self.sets:
            raise FileError(
                f"{self.path} has no sets {label!r} in the group {group!r}; "
                "the commands beside it make it anew"
            )
        return self.sets[label, group]


@dataclass(frozen=True)
class Published:
    """A folder of published results.

    Attributes:
        path: The folder.
    """

    path: Path

    def evaluation_file(self, part: str) -> Path:
        """The file of an evaluation, which need not exist."""
        return self.path / part / "bench.json"

    def rows_file(self, part: str) -> Path:
        """The rows of a run, which need not exist."""
        return RunFolder(self.path / part).rows

    @property
    def growth_file(self) -> Path:
        """The times of the planning cycle, which need not exist."""
        return self.path / "cycle" / "bench.json"

    def evaluation(self, part: str) -> Evaluation:
        """Reads an evaluation.

        Args:
            part: Subfolder that holds it, ``prediction`` or ``calibration``.

        Returns:
            Its figures.

        Raises:
            FileError: It is missing, or is none.
        """
        path = self.evaluation_file(part)
        content = _read(path, f"dosplan evaluate ... --json {path}")
        try:
            sets = {
                key: Sets(
                    horizon=_column(rows, "horizon_s"),
                    coverage=100.0 * _column(rows, "cr"),
                    half=100.0 * Z95 * _column(rows, "cr_se"),
                    area=_column(rows, "osa"),
                )
                for key, rows in _by(content["sets"], "method", "group").items()
            }
            if len({tuple(found.horizon) for found in sets.values()}) > 1:
                raise ValueError("its sets are not all of the same horizons")
            return Evaluation(
                path=path,
                options={
                    _text(method["label"]): dict(method["options"])
                    for method in content["data"]["methods"]
                },
                sets=sets,
                limits={
                    key: _column(rows, "area")
                    for key, rows in _by(
                        content["upper_limits"], "model", "group", "representation"
                    ).items()
                },
            )
        except (KeyError, TypeError, ValueError) as error:
            raise _other(path, "dosplan evaluate", error) from None

    def rows(self, part: str) -> list[Score]:
        """Reads the rows of a run.

        Args:
            part: The run's folder, ``suite-1`` or ``recorded``.

        Returns:
            Its rows.

        Raises:
            FileError: It is missing, or is no finished run.
        """
        return read_run(self.path / part)[1]

    def growth(self) -> dict[str, dict[float, dict[str, float]]]:
        """Reads how the planning cycle grows.

        Returns:
            Times in ms by what grows (``road_users``, ``horizon_s``, ``lanelets``) and how much
            of it there is.

        Raises:
            FileError: The file is missing, or is not what the timing script writes.
        """
        path = self.growth_file
        content = _read(path, f"make bench BENCH_ARGS='--json {path}'")
        try:
            found = {
                what: {
                    float(amount): {part: float(ms) for part, ms in times.items()}
                    for amount, times in content[what].items()
                }
                for what in ("road_users", "horizon_s", "lanelets")
            }
        except (AttributeError, KeyError, TypeError, ValueError) as error:
            raise _other(path, "make bench", error) from None
        for what, times in found.items():
            if not times:
                raise FileError(f"{path} has no times over {what}; its planner has one only")
        return found


def _read(path: Path, command: str) -> Any:
    if not path.is_file():
        raise FileError(f"{path} is missing; `{command}` makes it, --results names another folder")
    return read_json(path)


def _other(path: Path, command: str, error: Exception) -> FileError:
    said = " ".join(f"{type(error).__name__}: {error}".split())
    return FileError(f"{path} is not what `{command}` of this version writes ({said})")


def _text(value: Any) -> str:
    if not isinstance(value, str):
        raise TypeError(f"the label {value!r:.100} is no text")
    return value


def _by(rows: Any, *keys: str) -> dict[Any, list[Mapping[str, Any]]]:
    """Rows that agree on some keys, in their order."""
    found: dict[Any, list[Mapping[str, Any]]] = {}
    for row in rows:
        found.setdefault(tuple(row[key] for key in keys), []).append(row)
    return found


def _column(rows: list[Mapping[str, Any]], key: str) -> FloatArray:
    """What the rows have under a key; NaN where that is None."""
    return np.array([row[key] for row in rows], dtype=np.float64)
