"""Why an episode of a run ended as it did, from its run folder and its scenario file."""

from dosplan.explain.explanation import Explanation, explain, explain_drive, shown_notes

__all__ = ["Explanation", "explain", "explain_drive", "shown_notes"]
