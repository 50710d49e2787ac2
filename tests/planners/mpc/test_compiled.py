"""Libraries of the optimal control problem: same solutions, right names, safe to lose."""

from __future__ import annotations

import re
import shutil
import sys
import warnings
from dataclasses import replace
from hashlib import sha256
from pathlib import Path
from typing import Any

import casadi as ca
import numpy as np
import pytest
from dosplan_mpc import compiled, nlp
from dosplan_mpc.compiled import CompileError, is_whole
from dosplan_mpc.config import MpcConfig, SamplerSettings, TrafficSettings
from dosplan_mpc.nlp import Guess, MpcProblem, Solution
from dosplan_mpc.obstacles import ForbiddenSets

from dosplan.cli.main import main
from dosplan.system.folders import cache_folder
from dosplan.types import SolveStatus
from dosplan.vehicle import VehicleParameters
from tests.planners.mpc.roads import straight_stages

TINY = replace(MpcConfig(), horizon=3, slots=1)  # It compiles in seconds.
VEHICLE = VehicleParameters()
DT = 0.1
needs_compiler = pytest.mark.skipif(
    not any(map(shutil.which, ("cc", "gcc", "clang"))), reason="there is no C compiler"
)


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A cache that holds the library of the tiny problem."""
    folder = tmp_path_factory.mktemp("compiled")
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("DOSPLAN_CACHE", str(folder))
        patch.delenv("CC", raising=False)
        formulation = MpcProblem(TINY, VEHICLE, DT).formulation
        formulation.compile(formulation.library())
    return folder


@pytest.fixture
def cache(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """An empty cache of the test's own."""
    monkeypatch.setenv("DOSPLAN_CACHE", str(tmp_path))
    monkeypatch.delenv("CC", raising=False)
    return tmp_path


@pytest.fixture
def library(made: Path, cache: Path) -> Path:
    """The tiny problem's library, in a cache of the test's own."""
    shutil.copytree(made, cache, dirs_exist_ok=True)
    return next(cache.glob("mpc/*.so"))


def solve(problem: MpcProblem) -> Solution:
    """A car beside its path at 10 m/s, with a set ahead on the right that it touches."""
    n = problem.config.horizon
    states = np.zeros((n + 1, 6))
    states[:, 0] = np.arange(n + 1)
    states[:, 3] = 10.0
    sets = ForbiddenSets(
        ids=np.array([7]),
        centre=np.tile([6.0, -1.0], (1, n, 1)),
        matrix=np.tile(np.diag([0.3, 0.5]), (1, n, 1, 1)),
        penalty=np.full((1, n), 200.0),
    )
    stages = straight_stages(states[:, 0], problem.config.slots, sets)
    guess = Guess(states, np.zeros((n, 2)), np.zeros(n), states[:, 0].copy())
    start = np.array([0.0, 0.4, 0.01, 10.0, 0.02, 0.3])
    return problem.solve(start, stages, guess, np.zeros((n, 1)))


def made_without_warning() -> MpcProblem:
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        return MpcProblem(TINY, VEHICLE, DT)


@needs_compiler
def test_the_solution_is_that_of_the_virtual_machine_to_the_last_bit(
    library: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    problem = made_without_warning()
    assert problem.formulation.library() == library
    by_library = solve(problem)
    monkeypatch.setenv("DOSPLAN_CACHE", str(library.parent / "empty"))
    by_machine = solve(made_without_warning())
    assert by_library.status is SolveStatus.SOLVED
    assert by_library.iterations == by_machine.iterations > 3
    assert by_library.set_slack.max() > 1e-3  # The set, the hardest term, counts.
    assert (by_library.cost, by_library.residual) == (by_machine.cost, by_machine.residual)
    for name in ("states", "inputs", "set_slack", "road_slack"):
        np.testing.assert_array_equal(getattr(by_library, name), getattr(by_machine, name))


@needs_compiler
def test_the_library_itself_is_what_solves(library: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    taken = []
    build = ca.nlpsol

    def spy(name: str, solver: str, source: Any, options: Any) -> Any:
        taken.append(source)
        return build(name, solver, source, options)

    monkeypatch.setattr(ca, "nlpsol", spy)
    MpcProblem(TINY, VEHICLE, DT)
    assert taken == [str(library)]


def half(library: Path) -> None:
    """The disk was full, and the machine lost what it had promised to write."""
    data = library.read_bytes()
    library.unlink()  # Never shorten a file that this process has loaded.
    library.write_bytes(data[: len(data) // 2])


def foreign(library: Path) -> None:
    """The cache came from another kind of machine: whole, but nothing to load."""
    data = b"\xcf\xfa\xed\xfe" + bytes(2000)
    library.write_bytes(data)
    library.with_suffix(".sha256").write_text(sha256(data).hexdigest())


def gone(library: Path) -> None:
    library.unlink()


@needs_compiler
@pytest.mark.parametrize("damage", [half, foreign, gone])
def test_what_cannot_be_loaded_is_a_warning_and_not_used(library: Path, damage: object) -> None:
    assert callable(damage)
    damage(library)
    with pytest.warns(UserWarning, match=f"{library.name} cannot be loaded.*compile --force") as w:
        problem = MpcProblem(TINY, VEHICLE, DT)
    assert len(w) == 1
    assert "\n" not in str(w[0].message)
    assert solve(problem).status is SolveStatus.SOLVED


@needs_compiler
def test_a_library_without_its_digest_is_none(library: Path) -> None:
    """As when a compilation was killed between the two files: to be compiled again, no damage."""
    library.with_suffix(".sha256").unlink()
    assert not is_whole(library)
    assert solve(made_without_warning()).status is SolveStatus.SOLVED


def test_every_problem_has_a_file_of_its_own(cache: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    same = MpcProblem(TINY, VEHICLE, DT).formulation.library()
    others = [
        MpcProblem(config, vehicle, dt).formulation.library()
        for config, vehicle, dt in (
            (replace(TINY, slots=2), VEHICLE, DT),
            (replace(TINY, horizon=4), VEHICLE, DT),
            (replace(TINY, jerk_weight=0.02), VEHICLE, DT),
            (replace(TINY, road_margin=0.2), VEHICLE, DT),
            (replace(TINY, norm_rounding=1e-3), VEHICLE, DT),
            (replace(TINY, slack_curvature=0.02), VEHICLE, DT),
            (TINY, replace(VEHICLE, wheelbase=2.6), DT),
            (TINY, VEHICLE, 0.2),
        )
    ]
    formulation = MpcProblem(TINY, VEHICLE, DT).formulation
    assert formulation.library() == same
    monkeypatch.setattr(compiled, "version", lambda _: "0.0")
    others.append(formulation.library())
    assert len({same, *others}) == 1 + len(others)
    assert {path.parent for path in others} == {cache / "mpc"} == {cache_folder() / "mpc"}


def test_what_only_steers_the_solver_shares_the_file(cache: Path) -> None:
    """A problem is the same however far it is solved and whoever plans with it."""
    libraries = {
        MpcProblem(config, VEHICLE, DT).formulation.library()
        for config in (
            TINY,
            replace(TINY, max_iterations=9, tolerance=1e-4, resample_every=2),
            replace(TINY, sampler=SamplerSettings(lane=3.0), traffic=TrafficSettings(headway=1.0)),
        )
    }
    assert len(libraries) == 1


@pytest.mark.parametrize(
    ("compiler", "said"),
    [
        ("", r"no C compiler \(cc, gcc, clang\): install one, or name it in \$CC"),
        ("no-such-compiler -m64", r"no C compiler \(no-such-compiler -m64\): install one"),
        ("{python} -c 'raise SystemExit(3)'", "failed: exit code 3"),
        (
            "{python} -c 'raise SystemExit(\"mpc.c: In f:\\nmpc.c:1: error: odd\\n1 | x\")'",
            "failed: mpc.c:1: error: odd",
        ),
    ],
)
def test_a_compiler_that_is_missing_or_fails_is_one_line(
    cache: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
    compiler: str,
    said: str,
) -> None:
    monkeypatch.setenv("CC", compiler.format(python=sys.executable))
    monkeypatch.setenv("PATH", str(cache / "no-programs"))
    problem = MpcProblem(TINY, VEHICLE, DT)
    with pytest.raises(CompileError, match=said):
        problem.formulation.compile(problem.formulation.library())
    monkeypatch.setattr(nlp, "problems", lambda *_: (problem,))
    assert main(["compile"]) == 2
    error = capsys.readouterr().err
    assert error.count("\n") == 1
    assert re.search(said, error)
    assert not list(cache.rglob("*.*"))


@needs_compiler
def test_the_command_makes_what_is_missing_or_damaged_or_asked_for(
    library: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    problem = MpcProblem(TINY, VEHICLE, DT)
    monkeypatch.setattr(nlp, "problems", lambda *_: (problem,))
    assert main(["compile"]) == 0
    assert capsys.readouterr().out == f"{library}: 1 road users, is there already\n"
    half(library)
    assert main(["compile"]) == 0
    begun, done = capsys.readouterr().out.splitlines()
    assert begun == "compiling problem 1 of 1 ..."
    assert done.startswith(f"{library}: 1 road users, compiled in ")
    assert is_whole(library)
    before = library.stat().st_ino
    assert main(["compile", "--force"]) == 0
    assert "compiled in" in capsys.readouterr().out
    assert is_whole(library)
    assert library.stat().st_ino != before  # A new file: a process may still run the old one.
    made_without_warning()


def test_the_planner_solves_for_few_and_for_many(cache: Path) -> None:
    problems = nlp.problems(replace(TINY, slots=3), VEHICLE, DT)
    assert [problem.config.slots for problem in problems] == [1, 2, 3]
    assert nlp.problems(replace(TINY, slots=3), VEHICLE, DT) == problems
