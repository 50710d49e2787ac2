"""Submits a run to the leaderboard: checks it whole, scores it again, and makes its row."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Final

from dosplan import __version__
from dosplan.api import OraclePredictor
from dosplan.plugins.registry import (
    PluginKind,
    RegistryError,
    choose_plugin,
    choose_predictor,
    list_plugins,
)
from dosplan.results.folder import RunFolder
from dosplan.results.leaderboard import About, ArmResult, Submission, SubmissionError
from dosplan.results.manifest import SCENARIO_FILES, RunManifest
from dosplan.results.markdown import unranked_reason
from dosplan.results.rescore import change_lines, rescore
from dosplan.results.rows import read_run
from dosplan.results.scenario_sets import ScenarioSet, known_sets
from dosplan.running.run import scenario_files
from dosplan.scenario import ScenarioError, find_scenarios
from dosplan.scoring.score import failed_score
from dosplan.simulation.traffic import Traffic
from dosplan.system.files import FileError
from dosplan.system.provenance import content_digest
from dosplan.types import Arm, Outcome, Score

NOBODY: About = About()

FEWEST_FUTURES: Final = 2
"""Futures of each scenario that a run drives at least, of a set of which several are recorded.

One alone is won by who bets on what was recorded; two are what ``make run`` drives.
"""


def make_submission(
    run: Path,
    about: About = NOBODY,
    source: str | None = None,
    progress: Callable[[int, int], None] = lambda done, total: None,
) -> Submission:
    """Checks a run and makes its row. Nothing is written.

    Args:
        run: The run folder, with its episode files.
        about: What its authors say of it.
        source: Where the scenarios lie now; where the run found them if None. An embedded suite
            is always that of dosplan.
        progress: Called with the number of episodes that are scored again and of all.

    Returns:
        The row.

    Raises:
        SubmissionError: The leaderboard does not take the run; it holds every reason. What takes
            long is done only where nothing else speaks against the run: to look at the
            scenario files and to score the run again.
        FileError: A file of dosplan's own cannot be read.
        ScenarioError: Likewise.
    """
    try:
        manifest, rows = read_run(run)
    except FileError as error:
        raise SubmissionError([str(error)]) from None
    sets = known_sets()
    chosen = _set_of(manifest, sets)
    reasons = [*_not_ranked(manifest), *_other_version(manifest), *_not_driven(run, manifest, rows)]
    if chosen is None:
        names = ", ".join(one.name for one in sets)
        reasons.append(f"its scenarios are of no set that the leaderboard has ({names})")
    else:
        reasons += _incomplete(manifest, chosen)
    if not reasons and chosen is not None:
        where = source or chosen.source or manifest.config.source
        try:
            reasons += _other_files(manifest, chosen, where) or _other_rows(run, where, progress)
        except (FileError, ScenarioError, RegistryError) as error:
            reasons.append(str(error))
    if reasons or chosen is None:
        raise SubmissionError(reasons)
    return _submission(manifest, rows, chosen, about)


def _set_of(manifest: RunManifest, sets: Sequence[ScenarioSet]) -> ScenarioSet | None:
    """The set that a run is of, or of which it drives a part."""
    driven = set(manifest.scenarios)
    best = max(sets, key=lambda one: len(driven & set(one.scenarios)))
    return best if driven & set(best.scenarios) else None


def _not_ranked(manifest: RunManifest) -> Iterator[str]:
    config = manifest.config
    if not config.ranked:
        yield "it is not ranked: it was driven with --unranked"
    if not manifest.reproducible:
        yield f"it is not ranked: {unranked_reason(reproducible=False)}"
    try:
        predictor = choose_predictor(config.predictor, config.predictor_options)
    except RegistryError as error:
        yield (
            f"its predictor cannot be loaded, so nobody can tell whether it sees the future "
            f"({error}); submit the run where it was driven"
        )
    else:
        if issubclass(predictor.plugin, OraclePredictor):
            yield f"its predictor {manifest.predictor} is shown the future"
    ours = {one.name for one in list_plugins(PluginKind.TRAFFIC) if one.distribution == "dosplan"}
    if config.traffic not in ours:
        yield (
            f"its traffic {config.traffic} is not one of dosplan's, which the leaderboard has "
            f"({', '.join(sorted(ours))})"
        )


def _other_version(manifest: RunManifest) -> Iterator[str]:
    version = manifest.versions.get("dosplan", "unknown")
    if version != __version__:
        yield (
            f"it was driven and scored by dosplan {version}, and this is {__version__}: "
            "drive it again, or submit it with that version"
        )


def _not_driven(run: Path, manifest: RunManifest, rows: Sequence[Score]) -> Iterator[str]:
    """Tells of rows that no recording stands behind: failures of the planner alone may be so."""
    others = [row for row in rows if not row.outcome.of_planner]
    if others:
        what = {
            Outcome.UNUSABLE: "are called unusable",
            Outcome.TRAFFIC_FAILURE: "the traffic failed",
        }
        yield (
            f"{len(others)} episodes are not the planner's, as {others[0].key.title} "
            f"({what[others[0].outcome]}): drive them again (delete their lines in "
            f"{RunFolder(run).rows} and give the same command)"
        )
    folder = RunFolder(run)
    failed = [
        row
        for row in rows
        if row.outcome is Outcome.PLANNER_FAILURE and not folder.recording(row.key).exists()
    ]
    odd = [r for r in failed if r != manifest.row(failed_score(r.key, r.error or ""))]
    if odd:
        yield (
            f"{len(odd)} rows of failures without a recording have figures, as {odd[0].key.title}: "
            "drive them again"
        )


def _incomplete(manifest: RunManifest, chosen: ScenarioSet) -> Iterator[str]:
    driven, wanted = set(manifest.scenarios), set(chosen.scenarios)
    if lacking := len(wanted - driven):
        yield (
            f"it drives {len(wanted) - lacking} of the {len(wanted)} scenarios of {chosen.name}: "
            "the same command without --limit, --sample, --only and ids drives the rest"
        )
    if more := sorted(driven - wanted):
        yield (
            f"it drives {len(more)} scenarios that {chosen.name} does not hold, as {more[0]}: "
            f"drive {chosen.name} alone"
        )
    fewest = min(FEWEST_FUTURES, chosen.futures)
    if manifest.config.futures < fewest:
        yield (
            f"it drives {manifest.config.futures} of the {chosen.futures} futures of "
            f"{chosen.name}, where at least {fewest} are asked for: the same command with "
            f"--futures {fewest} drives the rest"
        )


def _other_files(
    manifest: RunManifest, chosen: ScenarioSet, where: str | tuple[str, ...]
) -> list[str]:
    refs = {ref.id: ref for ref in find_scenarios(where)}
    if not chosen.is_in(refs):
        return [
            f"the files in {where} are not those of {chosen.name}: one is missing or has another "
            "content; name where they lie with --source"
        ]
    config = manifest.config
    traffic: type[Traffic] = choose_plugin(
        PluginKind.TRAFFIC, config.traffic, config.traffic_options
    ).plugin
    files = scenario_files(traffic, (refs[name] for name in manifest.scenarios))
    if content_digest(files) != manifest.digests.get(SCENARIO_FILES):
        return [f"it drove other files than those of {chosen.name}: drive these"]
    return []


def _other_rows(
    run: Path, where: str | tuple[str, ...], progress: Callable[[int, int], None]
) -> list[str]:
    changes = rescore(run, where, progress).changes
    if not changes:
        return []
    return [
        f"{len(changes)} rows are not what scoring their recordings gives "
        f"({change_lines(changes[:1])[0]}): see dosplan score {run}"
    ]


def _submission(
    manifest: RunManifest, rows: Sequence[Score], chosen: ScenarioSet, about: About
) -> Submission:
    config = manifest.config
    by_arm = {arm: [row for row in rows if row.arm is arm] for arm in config.arms}
    order = {name: number for number, name in enumerate(chosen.scenarios)}
    for mine in by_arm.values():
        mine.sort(key=lambda row: order[row.scenario])
    return Submission(
        about=about,
        scenario_set=chosen.name,
        set_digest=chosen.digest,
        planner=manifest.planner,
        predictor=manifest.predictor,
        traffic=manifest.traffic,
        loop=manifest.loop,
        futures=config.futures,
        seed=config.seed,
        planner_options=config.planner_options,
        predictor_options=config.predictor_options,
        traffic_options=config.traffic_options,
        digests={name: one for name, one in manifest.digests.items() if name != SCENARIO_FILES},
        dosplan=manifest.versions["dosplan"],
        git_revision=manifest.git_revision,
        started=manifest.started,
        arms={arm: ArmResult.of(by_arm[arm]) for arm in Arm if arm in by_arm},
    )
