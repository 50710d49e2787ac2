"""Cases of plug-ins that are none, are broken, or are rude: no line, no building, no good plan.

Plug-ins are code that the user names, and what they do is theirs; but one that cannot be used is
refused in a line that says why, and one that can be is driven, whatever it returns.
"""

from __future__ import annotations

from functools import cache
from typing import Final

from dosplan.plugins.registry import create_planner, create_predictor
from dosplan.scenario import load_scenario
from dosplan.types import Scenario
from tests.fuzz.driving import drive
from tests.fuzz.harness import Case, one_line_at_most
from tests.fuzz.originals import OURS
from tests.support.suite import SUITE

_CLASS: Final = """\
from dosplan.api import Planner, Predictor
{before}
class Mine({base}):
    {body}
"""
_SOURCES: Final[tuple[bytes, ...]] = (
    b"", b"\0", b"\xff\xfe", b"# coding: x\n", b"# coding: utf-16\n", b"import nowhere\n",
    b"x = (\n", b"raise SystemExit(3)\n", b"1/0\n", b"Mine = 1\n", b"Mine = None\n",
    b"class Mine: pass\n", b"def Mine(): pass\n", b"(" * 5000,
    b"def __getattr__(name): raise RuntimeError('no')\n", b"import sys; sys.exit('bye')\n",
    b"raise type('E', (Exception,), {'__str__': lambda self: 1/0})\n",
    b"raise Exception('a\\nb')\n",
    b"class M(type):\n    def __getattribute__(c, n): raise ValueError(n)\n"
    b"class Mine(metaclass=M): pass\n", b"def f(): f()\nf()\n",
)  # fmt: skip
_BODIES: Final = (
    "pass", "name = 'mine'", "name = 3", "name = None", "def __init__(self): pass",
    "name = 'mine'\n    def __init__(self, **options): raise ValueError('no\\nway')",
    "name = 'mine'\n    def __init__(self, **options): raise SystemExit",
    "name = 'mine'\n    settings = 3", "name = 'mine'\n    settings = int",
    "name = 'mine'\n    __init__ = None", "name = 'mine'\n    __init__ = 3",
    "name = property(lambda self: 1/0)", "name = 'mine'\n    __new__ = lambda *a, **k: 1/0",
    "__slots__ = 3", "__abstractmethods__ = 3",
)  # fmt: skip
_SPECS: Final = (
    "", ":", "a:", ":a", "a:b:c", ".:a", "..a:b", "a.:b", "os:system", "os:", "builtins:object",
    "dosplan.api:Planner", "dosplan.api:Predictor", "nowhere.py:Mine", "/dev/null.py:A", "x\0.py:A",
    "a\nb", "../x", "mpc ", "MPC", "\ud800", "a" * 1000, "dosplan.vehicle:a", "/:", "~.py:x", "é:é",
)  # fmt: skip
_OPTIONS: Final[tuple[dict[str, object], ...]] = ({}, {}, {"z": 1}, {"seed": 1}, {"": 1})

_RUDE: Final = """\
import sys
from dataclasses import replace
import numpy as np
from dosplan.api import {base}
from dosplan.types import Occupancy, Plan

def fail(error): raise error

class Mine({base}):
    {body}
    def {method}(self, observation, *others):
        n, t = len(observation.ids), 40
        states, inputs = np.tile(observation.ego, (t + 1, 1)), np.zeros((t, 2))
        users = dict(ids=observation.ids, centre=np.zeros((n, t, 2)), footprint=np.ones((n, 2)),
                     semi_axes=np.ones((n, t, 2)), angle=np.zeros((n, t)),
                     valid=np.ones((n, t), bool), heading=np.zeros((n, t)))
        return {value}
"""
_RESULTS: Final = (
    "None", "3", "type", "observation", "others[0]", "1 / 0", "self", "fail(SystemExit(3))",
    "fail(RecursionError('a\\nb'))", "sys.exit('no')",
    "fail(type('E', (Exception,), {'__str__': lambda self: 1 / 0})())", "fail(Exception('\ud800'))",
    "fail(Exception('a' * 100_000))", "getattr(self, observation)",
)  # fmt: skip
_PLANS: Final = (
    "Plan(states, inputs)", "Plan(states * np.nan, inputs)", "Plan(states, inputs + np.inf)",
    "Plan(states, inputs + 1e300)", "Plan(states, inputs - 1e9)", "Plan(states[:1], inputs[:0])",
    "Plan(states[:2], inputs[:1])", "Plan(states.T, inputs.T)", "Plan(states, None)",
    "Plan('', '')", "Plan(states + 1.0, inputs)", "Plan(states, inputs, report=3)",
    "Plan(states.astype(str), inputs.astype(object))", "Plan(states, inputs + 1j)",
    "Plan([[[]]], [[]])",
)  # fmt: skip
_SETS: Final = (
    "Occupancy(**users)", "Occupancy(**{**users, 'ids': users['ids'][::-1]})",
    "Occupancy(**{**users, 'semi_axes': users['semi_axes'] * -1})", "Occupancy(**{})",
    "Occupancy(**{**users, 'centre': users['centre'] * np.nan})",
    "Occupancy(**{**users, 'centre': users['centre'] + 1e300})",
    "Occupancy(**{**users, 'semi_axes': users['semi_axes'] * 1e300})",
    "Occupancy(**{**users, 'footprint': users['footprint'] * -1e300})",
    "Occupancy(**{**users, 'angle': users['angle'][:, :3]})",
    "Occupancy(**{**users, 'valid': users['valid'].astype(str)})",
    "Occupancy(**{**users, 'ids': users['ids'] + 0.5})", "Occupancy(*[None] * 7)",
)  # fmt: skip


def broken_plugins(case: Case) -> None:
    """What is named is no plug-in, or one that is not complete."""
    kind = case.random.randrange(3)
    if kind == 0:
        spec = case.about = case.random.choice(_SPECS)
    else:
        if kind == 1:
            source = case.random.choice(_SOURCES)
        else:
            base = case.random.choice(("Planner", "Predictor", "int", "Planner, Predictor"))
            before = case.random.choice(("", "import dosplan.api as Mine", "Mine = 2"))
            body = case.random.choice(_BODIES)
            source = _CLASS.format(before=before, base=base, body=body).encode()
        file = case.write(case.random.choice(("mine.py", "a b.py", "\u00e9.py", "os.py")), source)
        spec = f"{file}:{case.random.choice(('Mine', 'Mine', 'Mine', 'Theirs', 'a.b', ''))}"
        case.about = repr(source[-100:])
    create = case.random.choice((create_planner, create_predictor))
    with one_line_at_most():
        create(spec, 0, case.random.choice(_OPTIONS))
        raise AssertionError("was built")


def rude_plugins(case: Case) -> None:
    """A complete plug-in cannot be built, raises, or returns what nobody can drive."""
    planner = case.random.random() < 0.5
    base, method = ("Planner", "compute_plan") if planner else ("Predictor", "compute_occupancy")
    value = case.random.choice(_RESULTS + (_PLANS if planner else _SETS) * 2)
    body, options = "name = 'mine'", _OPTIONS[0]
    if case.random.random() < 0.3:
        body, options = case.random.choice(_BODIES), case.random.choice(_OPTIONS)
    case.about = f"{body}, {value}"
    source = _RUDE.format(base=base, body=body, method=method, value=value)
    spec = f"{case.write('mine.py', source.encode(errors='replace'))}:Mine"
    with one_line_at_most(spec):
        if planner:
            drive(_scenario(), planner=create_planner(spec, 0, options))
        else:
            drive(_scenario(), predictor=create_predictor(spec, 0, options))


@cache
def _scenario() -> Scenario:
    return load_scenario(SUITE / "files" / f"{OURS[0]}.xml.gz")
