"""``dosplan compile``: compiles the planner's problems to machine code, once per machine."""

from __future__ import annotations

import argparse
import time
from typing import Final

from dosplan.cli.command import OK, CommandError


class CompileCommand:
    """``dosplan compile``: compiles the planner's problems into the cache."""

    summary = "compile the problems of the planner mpc, which solves them quicker then"

    def add_arguments(self, parser: argparse.ArgumentParser) -> None:
        """Declares the arguments."""
        parser.description = (
            "Takes a C compiler ($CC, or else cc, gcc or clang) and minutes, once; plans stay the "
            "same to the last bit."
        )
        parser.add_argument("--force", action="store_true", help="compile what is there as well")

    def run(self, options: argparse.Namespace) -> int:
        """Compiles, and says what was made and where.

        Raises:
            CommandError: There is no compiler, or it fails.
            FileError: A library cannot be written.
        """
        from dosplan.types import STEP_SECONDS
        from dosplan.vehicle import VehicleParameters
        from dosplan_mpc import nlp
        from dosplan_mpc.compiled import CompileError, is_whole
        from dosplan_mpc.config import MpcConfig

        problems = nlp.problems(MpcConfig(), VehicleParameters(), STEP_SECONDS)
        for number, problem in enumerate(problems, start=1):
            path = problem.formulation.library()
            began = time.perf_counter()
            if is_whole(path) and not options.force:
                said = "is there already"
            else:
                print(f"compiling problem {number} of {len(problems)} ...", flush=True)
                try:
                    problem.formulation.compile(path)
                except CompileError as error:
                    raise CommandError(str(error)) from None
                said = f"compiled in {time.perf_counter() - began:.0f} s"
            print(f"{path}: {problem.config.slots} road users, {said}", flush=True)
        return OK


COMPILE: Final = CompileCommand()
