"""Specified sets: circles whose radius is a rule, around any trajectory predictor.

The baselines of "Towards Safe and Reliable Autonomous Driving: Dynamic Occupancy Set
Prediction" (Shao, Xu, Yu, Li, Wang): a fixed radius r; v1, r = z t; v2, r = z r_e(t) with r_e
the mean displacement error of the trajectory at that step. The trajectory comes from another
predictor, the ``base``::

    GrowingCirclePredictor(
        settings=GrowingCircleSettings(z=0.7, base=PluginSpec(ConstantTurnRatePredictor))
    )

Kinds that do not move (parked, static) keep sets of radius zero.
"""

from __future__ import annotations

import json
from abc import abstractmethod
from dataclasses import dataclass, replace
from importlib import resources
from pathlib import Path
from typing import Any, Self

import numpy as np

from dosplan.api import PluginSpec, Predictor, PredictorSettings
from dosplan.types import FloatArray, Observation, Occupancy, PlanningTask, RoadMap
from dosplan_simple.predictors import ConstantVelocityPredictor


@dataclass(frozen=True)
class ErrorTable:
    """Mean displacement error of a predictor by step.

    Attributes:
        predictor: Name of the predictor that was measured.
        dt: Step, s.
        mean_error: (T,) mean distance between predicted and true centre, m, at steps 1 .. T.
        samples: T numbers of predictions behind each mean.
        command: How the table was made.
    """

    predictor: str
    dt: float
    mean_error: tuple[float, ...]
    samples: tuple[int, ...]
    command: str

    @classmethod
    def load(cls, path: Path) -> Self:
        """Reads a table that ``python -m dosplan_simple.measure`` wrote.

        Args:
            path: The file.

        Returns:
            The table.

        Raises:
            ValueError: The file is missing or not such a table.
        """
        try:
            content: dict[str, Any] = json.loads(path.read_text(encoding="utf-8"))
            return cls(
                predictor=str(content["predictor"]),
                dt=float(content["dt"]),
                mean_error=tuple(float(x) for x in content["mean_error"]),
                samples=tuple(int(x) for x in content["samples"]),
                command=str(content["command"]),
            )
        except (OSError, json.JSONDecodeError, KeyError, TypeError) as error:
            raise ValueError(
                f"{path}: not a table of prediction errors ({type(error).__name__}: {error}); "
                "make one with python -m dosplan_simple.measure"
            ) from None

    def dump(self, path: Path) -> None:
        """Writes the table.

        Args:
            path: The file.
        """
        content = {
            "predictor": self.predictor,
            "dt": self.dt,
            "command": self.command,
            "samples": self.samples,
            "mean_error": [round(x, 4) for x in self.mean_error],
        }
        path.write_text(json.dumps(content) + "\n", encoding="utf-8")


@dataclass(frozen=True)
class CircleSettings(PredictorSettings):
    """The options of every predictor of circles.

    Attributes:
        base: Where the centres come from.
    """

    base: PluginSpec[Predictor] = PluginSpec(ConstantVelocityPredictor)

    def __post_init__(self) -> None:
        super().__post_init__()
        self.check_reach(self.base)


@dataclass(frozen=True)
class FixedCircleSettings(CircleSettings):
    """The options of circles that do not grow.

    Attributes:
        r: Radius, m.
    """

    r: float = 1.0

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.r < 0.0:
            raise ValueError(f"r is {self.r}, expected 0 or more")


@dataclass(frozen=True)
class GrowingCircleSettings(CircleSettings):
    """The options of circles that grow with time.

    Attributes:
        z: Growth, m/s.
    """

    z: float = 0.5

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.z < 0.0:
            raise ValueError(f"z is {self.z}, expected 0 or more")


@dataclass(frozen=True)
class ErrorCircleSettings(CircleSettings):
    """The options of circles in proportion to a measured error.

    Attributes:
        z: Factor on the mean error.
        table: File of the mean error of ``base``; by default the one that ships, which is there
            for the trajectory predictors of this project.
    """

    z: float = 1.0
    table: Path | None = None

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.z < 0.0:
            raise ValueError(f"z is {self.z}, expected 0 or more")


class CirclePredictor(Predictor):
    """Circles around the centres that another predictor predicts."""

    settings = CircleSettings

    def __init__(self, *, seed: int = 0, settings: CircleSettings = CircleSettings()) -> None:
        """Builds the trajectory predictor.

        Args:
            seed: Seed of the run, for that predictor; nothing here is random.
            settings: The options.
        """
        super().__init__(seed=seed, settings=settings)
        self.base = settings.base.build(seed)

    def weight_files(self) -> tuple[Path, ...]:
        """Those of the trajectory predictor."""
        return self.base.weight_files()

    @abstractmethod
    def radius(self, dt: float) -> FloatArray:
        """Radius of the circles by step.

        Args:
            dt: Step, s.

        Returns:
            (T,) radius at each predicted step, m.
        """

    def prepare(self, task: PlanningTask, road_map: RoadMap) -> None:
        """Begins an episode of the trajectory predictor."""
        self.base.reset(task, road_map)

    def compute_occupancy(self, observation: Observation) -> Occupancy:
        """Draws the circles.

        Returns:
            The base's centres with circles of the rule's radius.
        """
        trajectory = self.base.predict(observation).likeliest().first_steps(self.horizon)
        moves = observation.moves
        radius = moves[:, None] * self.radius(observation.dt)
        return replace(
            trajectory,
            semi_axes=np.repeat(radius[..., None], 2, axis=-1),
            angle=np.zeros_like(radius),
        )


class FixedCirclePredictor(CirclePredictor):
    """The same radius at every step."""

    name = "fixed-circle-v1"
    settings = FixedCircleSettings

    def __init__(
        self, *, seed: int = 0, settings: FixedCircleSettings = FixedCircleSettings()
    ) -> None:
        """Keeps the radius.

        Args:
            seed: Seed of the run, for the trajectory predictor.
            settings: The options.
        """
        super().__init__(seed=seed, settings=settings)
        self.r = settings.r

    def radius(self, dt: float) -> FloatArray:
        """Constant.

        Args:
            dt: Step, s.

        Returns:
            (T,) m.
        """
        return np.full(self.horizon, self.r)


class GrowingCirclePredictor(CirclePredictor):
    """A radius that grows with time: r = z t.

    In closed loop on training and validation scenarios the default of z did better than circles
    of the mean error (``ErrorCirclePredictor``). The paper has z = 0.7 m/s and z = 1 m/s; at the
    latter a road user blocks the lanes beside its own after 3 s.
    """

    name = "growing-circle-v1"
    settings = GrowingCircleSettings

    def __init__(
        self, *, seed: int = 0, settings: GrowingCircleSettings = GrowingCircleSettings()
    ) -> None:
        """Keeps the growth.

        Args:
            seed: Seed of the run, for the trajectory predictor.
            settings: The options.
        """
        super().__init__(seed=seed, settings=settings)
        self.z = settings.z

    def radius(self, dt: float) -> FloatArray:
        """Linear in time.

        Args:
            dt: Step, s.

        Returns:
            (T,) m.
        """
        return np.asarray(self.z * dt * np.arange(1, self.horizon + 1), dtype=np.float64)


class ErrorCirclePredictor(CirclePredictor):
    """A radius in proportion to the trajectory's measured error: r = z r_e(t)."""

    name = "error-circle-v1"
    settings = ErrorCircleSettings

    def __init__(
        self, *, seed: int = 0, settings: ErrorCircleSettings = ErrorCircleSettings()
    ) -> None:
        """Reads the table.

        Args:
            seed: Seed of the run, for the trajectory predictor.
            settings: The options.

        Raises:
            ValueError: The table cannot be read, is another predictor's or too short.
        """
        super().__init__(seed=seed, settings=settings)
        self.z = settings.z
        self._table_file = settings.table or shipped_table(self.base.name)
        self.table = ErrorTable.load(self._table_file)
        if self.table.predictor != self.base.name:
            raise ValueError(
                f"{self.name}: the error table is that of {self.table.predictor}, the base is "
                f"{self.base.name}; measure it with python -m dosplan_simple.measure"
            )
        if len(self.table.mean_error) < self.horizon:
            raise ValueError(
                f"{self.name}: the error table ends at step {len(self.table.mean_error)}, "
                f"horizon is {self.horizon}; measure further or predict less"
            )

    def weight_files(self) -> tuple[Path, ...]:
        """The table, and the files of the trajectory predictor."""
        return (self._table_file, *super().weight_files())

    def radius(self, dt: float) -> FloatArray:
        """In proportion to the mean error; between the table's steps, interpolated.

        Args:
            dt: Step, s.

        Returns:
            (T,) m.
        """
        known = self.table.dt * np.arange(len(self.table.mean_error) + 1)
        asked = dt * np.arange(1, self.horizon + 1)
        return np.asarray(self.z * np.interp(asked, known, (0.0, *self.table.mean_error)))


def shipped_table(predictor: str) -> Path:
    """The error table of a trajectory predictor that comes with the package.

    Args:
        predictor: Its versioned name.

    Returns:
        The file; it need not be there.
    """
    return Path(str(resources.files("dosplan_simple") / "errors" / f"{predictor}.json"))
