"""Cases of configurations and settings that make no sense: one line each, at once."""

from __future__ import annotations

import random
from contextlib import suppress
from functools import cache
from pathlib import Path
from typing import Any, Final

import yaml
from dosplan_dos.training import SetTraining
from dosplan_net.commands import read_training
from dosplan_net.training.train import NetTraining

from dosplan.cli.command import BAD_INPUT
from dosplan.evaluation.methods import build, check_labels, read_methods
from dosplan.plugins.registry import PluginKind, choose_plugin, record
from dosplan.system.yaml_text import YamlError, parse_yaml
from tests.fuzz.byte_damage import damage_binary
from tests.fuzz.harness import Case, one_line_at_most, shell

_PREDICTORS: Final = Path(__file__).resolve().parents[2] / "predictors"

SCALARS: Final = (
    "", "~", "x", "1", "-1", "1.5", ".nan", "-.inf", "1e400", "9" * 5000, "1" + "0" * 400, "true",
    "[]", "{}", "[1, [2]]", "{a: 1}", "2020-01-01", "2020-13-45", "1:2:3", "0o9", "0b2", "0x", "'",
    '"', '"\\ud800"', '"\\x"', "!!int x", "!!int ''", "!!float ''", "!!bool x", "!!timestamp x",
    "!!binary x", "!!null x", "!!set {a}", "!!omap [a]", "!!pairs [a: 1]",
    "!!python/name:os.system ",
    "!!python/object/apply:os.system [id]", "!x y", "&a [*a]", "&a {b: *a}", "*a", "<<: 1",
    "{<<: [1]}", "? [1]", "? {a: b}\n: c", "{{a: b}: c}", "[" * 3000, "[" * 500 + "]" * 500,
    "- " * 3000, "%YAML 9.9", "---\n---", "\t", "\0", "\ufeff", "a: b: c", "@", "`", "|", ">",
    "!!str",
)  # fmt: skip
_OPTIONS: Final = (
    (PluginKind.PREDICTOR, "dos", (
        "horizon", "sets", "scale", "coverage", "simultaneous", "base", "base.horizon", "network",
        "threads", "engine", "base.base",
    )),
    (PluginKind.PREDICTOR, "growing-circle", ("z", "base", "base.horizon", "base.options", "")),
    (PluginKind.PREDICTOR, "error-circle", ("table", "z", "base")),
    (PluginKind.PLANNER, "mpc", (
        "horizon", "calm", "calm.lateral", "sampler", "sampler.accelerations", "tolerance",
        "sampler.lane.x", "calm..x",
    )),
)  # fmt: skip
_LAUGHS: Final = "[&a0 [x, x], " + ", ".join(
    f"&a{i} [{', '.join([f'*a{i - 1}'] * 9)}]" for i in range(1, 12)
) + "]"  # fmt: skip


def damaged_methods(case: Case) -> None:
    """Files of ``dosplan evaluate --methods``."""
    path = _damaged(case, _PREDICTORS / "simple.yaml")
    with one_line_at_most(path.name, "method"):
        methods = read_methods(path)
        check_labels(methods)
        for method in methods[:2]:
            build(method, seed=0)


def damaged_trainings(case: Case) -> None:
    """Files of ``dosplan train --config``."""
    name, kind = case.random.choice((("net.yaml", NetTraining), ("dos.yaml", SetTraining)))
    path = _damaged(case, _PREDICTORS / name)
    with one_line_at_most(path.name):
        assert isinstance(read_training(path, kind), kind)


def strange_settings(case: Case) -> None:
    """Values of ``dosplan run --set``; the source is not there, so that nothing is driven."""
    value = case.random.choice((*SCALARS, _LAUGHS))
    name = case.random.choice(
        ("planner.speed", "predictor.horizon", "x.y", "planner", "predictor.")
    )
    case.about = f"{name}={value[:50]}"
    source = str(case.folder / "nowhere")
    out = str(case.folder / "run")
    setting = f"{name}={value}".replace("\0", "")  # No argument can hold one.
    shell("run", source, "--out", out, "--set", setting, codes=[BAD_INPUT])


def strange_options(case: Case) -> None:
    """Options of plug-ins, and of plug-ins within them; what is taken can be recorded."""
    kind, name, known = case.random.choice(_OPTIONS)
    values = [*_values(), {"predictor": "net"}, {"predictor": "none", "options": {"horizon": {}}}]
    picked = [*case.random.sample(known, case.random.randint(1, 2))]
    options = {option: case.random.choice([*values, "dos", "none", 0.5]) for option in picked}
    case.about = f"{name}: {options!r:.100}"
    with one_line_at_most(name):
        chosen = choose_plugin(kind, name, options)
        assert choose_plugin(kind, name, record(chosen)) == chosen


@cache
def _values() -> tuple[Any, ...]:
    """What the scalars are that are YAML."""
    values = []
    for text in SCALARS:
        with suppress(YamlError):
            values.append(parse_yaml(text))
    return tuple(values)


def _damaged(case: Case, path: Path) -> Path:
    """A copy of a YAML file with something in it changed."""
    text = path.read_text(encoding="utf-8")
    kind = case.random.randrange(5)
    if kind == 0:
        data, case.about = damage_binary(case.random, text.encode())
    elif kind == 1:
        value = case.random.choice((*SCALARS, _LAUGHS))
        data, case.about = value.encode(errors="surrogatepass"), f"nothing but {value[:50]}"
    elif kind == 2:
        content = yaml.safe_load(text)
        case.about = _change(case.random, content)
        data = yaml.safe_dump(content).encode()
    else:
        lines = [line for line in text.splitlines() if ":" in line and "#" not in line]
        line = case.random.choice(lines)
        value = case.random.choice((*SCALARS, _LAUGHS))
        changed = f"{line.partition(':')[0]}: {value}"
        case.about = changed[:80]
        data = text.replace(line, changed, 1).encode(errors="surrogatepass")
    return case.write("config.yaml", data)


def _change(rng: random.Random, content: Any) -> str:
    """Puts something else in the place of a part."""
    places: list[tuple[Any, Any]] = []

    def collect(part: Any) -> None:
        keys = range(len(part)) if isinstance(part, list) else part
        for key in keys if isinstance(part, list | dict) else ():
            places.append((part, key))
            collect(part[key])

    collect(content)
    part, key = rng.choice(places)
    value = rng.choice(
        (None, 0, -1, 1.5, "x", "", [], {}, [1], {"a": 1}, True, float("nan"), 10**400, {1: 2},
         {None: 1}, {(1, 2): 3}, {"predictor": "dos"}, {"predictor": 1}, {"predictor": "a.b:C"})
    )  # fmt: skip
    if rng.random() < 0.2:
        del part[key]
        return f"without {key}"
    part[key] = value
    return f"{key}: {value!r:.50}"
