"""The value types of dosplan: one frozen dataclass of arrays for each arrow of the pipeline.

``Scenario -> Observation -> Occupancy -> Plan -> Episode -> Score``; nothing flows back.

Conventions shared by every type:

* Frame: the scenario's own right-handed Cartesian frame, x and y in metres. Angles are in
  radians, counter-clockwise from the x axis, and are not wrapped unless a docstring says so.
* Time is counted in steps of ``dt`` seconds; ``dt`` is 0.1 s everywhere after loading.
* An *ego state* is a row ``(x, y, steering_angle, velocity, heading)`` of the CommonRoad
  kinematic single track: x and y are those of the **rear axle**. ``dosplan.vehicle`` turns
  it into the centre of the ego's rectangle.
* A *road-user state* is a row ``(x, y, heading, velocity)`` of the shape's **centre**.
* Arrays are stored as read-only copies: a value cannot change once it is made, not even by the code
  that made it.
"""

from dosplan.types.arrays import (
    EGO_HEADING,
    EGO_SIZE,
    EGO_STEERING,
    EGO_VELOCITY,
    EGO_X,
    EGO_Y,
    USER_HEADING,
    USER_SIZE,
    USER_VELOCITY,
    USER_X,
    USER_Y,
    BoolArray,
    FloatArray,
    IntArray,
    ShapeError,
)
from dosplan.types.episode import (
    Arm,
    DrivenEpisode,
    Episode,
    EpisodeEnd,
    EpisodeKey,
    ScenarioFuture,
    Sightings,
)
from dosplan.types.lights import COLOURS, LightColour, LightStates, Signals
from dosplan.types.planning import (
    HISTORY_STEPS,
    Observation,
    Occupancy,
    Plan,
    SetUnion,
    SolveReport,
    SolveStatus,
)
from dosplan.types.road import (
    Incoming,
    Intersection,
    Lanelet,
    LineMarking,
    RoadMap,
    SignRule,
    StopLine,
    TrafficLight,
    TrafficSign,
)
from dosplan.types.scenario import (
    STEP_SECONDS,
    GoalState,
    PlanningTask,
    RoadUserKind,
    Route,
    RouteStop,
    Scenario,
    StopCause,
    Tracks,
    place_of,
    scene_of,
)
from dosplan.types.score import CollisionClass, Measure, Outcome, Score

__all__ = [
    "COLOURS",
    "EGO_HEADING",
    "EGO_SIZE",
    "EGO_STEERING",
    "EGO_VELOCITY",
    "EGO_X",
    "EGO_Y",
    "HISTORY_STEPS",
    "STEP_SECONDS",
    "USER_HEADING",
    "USER_SIZE",
    "USER_VELOCITY",
    "USER_X",
    "USER_Y",
    "Arm",
    "BoolArray",
    "CollisionClass",
    "DrivenEpisode",
    "Episode",
    "EpisodeEnd",
    "EpisodeKey",
    "FloatArray",
    "GoalState",
    "Incoming",
    "IntArray",
    "Intersection",
    "Lanelet",
    "LightColour",
    "LightStates",
    "LineMarking",
    "Measure",
    "Observation",
    "Occupancy",
    "Outcome",
    "Plan",
    "PlanningTask",
    "RoadMap",
    "RoadUserKind",
    "Route",
    "RouteStop",
    "Scenario",
    "ScenarioFuture",
    "Score",
    "SetUnion",
    "ShapeError",
    "Sightings",
    "SignRule",
    "Signals",
    "SolveReport",
    "SolveStatus",
    "StopCause",
    "StopLine",
    "Tracks",
    "TrafficLight",
    "TrafficSign",
    "place_of",
    "scene_of",
]
