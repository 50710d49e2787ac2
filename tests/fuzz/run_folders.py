"""Cases of damaged run folders: read, compared, shown and resumed, or refused in one line."""

from __future__ import annotations

import io
import json
import random
import shutil
import tempfile
from collections.abc import Callable, Iterator
from contextlib import chdir, contextmanager
from functools import cache, partial
from pathlib import Path
from typing import Any, Final

import numpy as np
import pytest

from dosplan.cli.command import BAD_INPUT, OK
from dosplan.explain import explain
from dosplan.report.html.write import write_report
from dosplan.results.folder import RunFolder
from dosplan.results.recording import Recording, load_cycle_ms
from dosplan.results.rows import read_run
from dosplan.running import run as runner
from dosplan.running.run import RunConfig
from dosplan.system.folders import cache_folder
from dosplan.system.provenance import Environment, Machine
from dosplan.types import Arm
from tests.fuzz.byte_damage import damage_binary
from tests.fuzz.harness import Case, one_line_at_most, shell
from tests.support.runs import configured, run_here, write_scenes

RUN: Final = Path("run")
SCENES: Final = Path("scenes")
"""In the folder of a case, which is the working folder; so no path differs from time to time."""
ENVIRONMENT: Final = Environment(
    versions={"dosplan": "1"}, git_revision=None, machine=Machine("linux", "x86_64", 2)
)
VALUES: Final[tuple[Any, ...]] = (
    None, True, 0, -1, 1, 1.5, 10**400, -(10**30), float("nan"), float("inf"), "", "x", "\ud800",
    "../../x", "<script>", "with_dos", "success", [], [[]], {}, {"a": 1}, "a" * 5000, 2**63,
)  # fmt: skip


def damaged_manifests(case: Case) -> None:
    """A ``run.json`` of which a value is absent or another."""
    folder, config = _copied(case)
    _damage_json(case, folder.manifest)
    _use(case, folder, config)


def damaged_rows(case: Case) -> None:
    """A ``scenarios.jsonl`` of which a line or a value is absent or another."""
    folder, config = _copied(case)
    lines = folder.rows.read_bytes().splitlines(keepends=True)
    kind = case.random.randrange(4)
    if kind == 0:
        data, case.about = damage_binary(case.random, b"".join(lines))
        folder.rows.write_bytes(data)
    elif kind == 1:
        case.about = "lines in another order, some of them twice or not at all"
        folder.rows.write_bytes(b"".join(case.random.choices(lines, k=case.random.randint(0, 6))))
    else:
        row = json.loads(lines[0])
        case.about = _change(case.random, row)
        folder.rows.write_text(json.dumps(row) + "\n" + b"".join(lines[1:]).decode())
    _use(case, folder, config)


def damaged_recordings(case: Case) -> None:
    """An episode file that is damaged, or holds other arrays."""
    folder, config = _copied(case)
    path = case.random.choice(sorted((folder.path / "episodes").glob("*.npz")))
    if case.random.random() < 0.5:
        data, case.about = damage_binary(case.random, path.read_bytes())
        path.write_bytes(data)
    else:
        with np.load(path) as file:
            arrays: dict[str, Any] = dict(file)
        case.about = _change_array(case.random, arrays)
        written = io.BytesIO()
        np.savez_compressed(written, allow_pickle=True, **arrays)
        path.write_bytes(written.getvalue())
    for load in (Recording.load, partial(load_cycle_ms, steps=10)):
        with one_line_at_most(path.name):
            load(path)
    _use(case, folder, config)


@cache
def _original() -> Path:
    """A folder with scenarios and a finished run of them; nobody may write to it."""
    cache_folder().mkdir(parents=True, exist_ok=True)  # Where every case may read.
    place = Path(tempfile.mkdtemp(dir=cache_folder()))
    with chdir(place), _without_git(), pytest.MonkeyPatch.context() as patch:
        patch.setattr("dosplan.api.time.perf_counter", lambda: 0.0)  # The same rows each time.
        run_here(configured(RUN, write_scenes(SCENES, 2)))
    return place


def _copied(case: Case) -> tuple[RunFolder, RunConfig]:
    shutil.copytree(_original(), case.folder, dirs_exist_ok=True)
    return RunFolder(RUN), configured(RUN, SCENES)


@contextmanager
def _without_git() -> Iterator[None]:
    with pytest.MonkeyPatch.context() as patch:
        # The real one asks git, which takes longer than all the rest.
        patch.setattr(runner, "describe_environment", lambda: ENVIRONMENT)
        yield


def _use(case: Case, folder: RunFolder, config: RunConfig) -> None:
    """Does with a run folder what the commands do."""
    names = [path.stem for path in Path(str(config.source)).iterdir()]
    with one_line_at_most():
        read_run(folder.path)
    with one_line_at_most():
        explain(folder.path, case.random.choice(names), list(Arm))
    what = case.random.randrange(4)
    if what == 0:
        shell("compare", str(folder.path), codes=(OK, BAD_INPUT))
    elif what == 1:
        with one_line_at_most():
            write_report(folder.path, case.folder / "report.html")
    elif what == 2:
        scene = case.random.choice(names)
        shell("render", f"{folder.path}:{scene}", "--out", "film.png", codes=(OK, BAD_INPUT))
    done = False
    with one_line_at_most(), _without_git():
        run_here(config)
        done = True
    if done:
        _, rows = read_run(folder.path)
        assert [row.scenario for row in rows] == sorted([*names, *names]), "a row was lost"


def _damage_json(case: Case, path: Path) -> None:
    if case.random.random() < 0.3:
        data, case.about = damage_binary(case.random, path.read_bytes())
        path.write_bytes(data)
        return
    content = json.loads(path.read_text())
    part = content
    while case.random.random() < 0.5:
        inner = [value for value in part.values() if isinstance(value, dict) and value]
        if not inner:
            break
        part = case.random.choice(inner)
    case.about = _change(case.random, part)
    path.write_text(json.dumps(content))


def _change(rng: random.Random, mapping: dict[str, Any]) -> str:
    name = rng.choice(sorted(mapping))
    kind = rng.randrange(8)
    if kind == 0:
        del mapping[name]
        return f"without {name}"
    if kind == 1:
        mapping[f"{name}s"] = mapping[name]
        return f"with {name}s"
    if kind == 2 and isinstance(mapping[name], list):
        mapping[name] = [*mapping[name], rng.choice(VALUES)]
    else:
        mapping[name] = rng.choice(VALUES)
    return f"{name} is {str(mapping[name])[:50]!r}"


def _change_array(rng: random.Random, arrays: dict[str, Any]) -> str:
    name = rng.choice(sorted(arrays))
    change: Callable[[Any], Any] = rng.choice(
        (
            lambda a: a[..., None], lambda a: a[:0] if a.ndim else a, lambda a: np.zeros(0),
            lambda a: a.astype(str), lambda a: a.astype(object), lambda a: np.array(None),
            lambda a: np.full(a.shape, np.nan), lambda a: np.full(a.shape, 1e300),
            lambda a: np.full(a.shape, -1), lambda a: np.full(a.shape, 10**9),
            lambda a: a[1:] if a.ndim else a, lambda a: np.concatenate([a, a]) if a.ndim else a,
            lambda a: a.T, lambda a: a.astype(complex) if a.dtype.kind in "fi" else a,
            lambda a: np.array("\ud800".encode("utf-16", "surrogatepass")), lambda a: a.ravel(),
        )
    )  # fmt: skip
    if rng.random() < 0.15:
        del arrays[name]
        return f"without {name}"
    before = arrays[name]
    arrays[name] = change(before)
    return f"{name}: {before.dtype} {before.shape} as {arrays[name].dtype} {arrays[name].shape}"
