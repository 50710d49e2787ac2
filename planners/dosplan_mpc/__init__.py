"""dosplan's optimisation planner: model-predictive control with CasADi and fatrop."""
