"""Open-loop evaluation: how often and how tightly a predictor's sets hold the recorded future.

``dosplan.evaluation.evaluate.evaluate`` takes any predictors through ``dosplan.api`` alone; the
figures are defined in ``metrics``, ``limits`` and ``groups``. ``tails`` measures the sets of a run
on its drives instead.
"""
