"""How the trajectory network is made: training windows, batches, the fit, and cross-fitting.

Nothing here is imported when a trained network predicts.
"""
