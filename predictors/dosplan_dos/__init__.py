"""Dynamic occupancy sets on top of any trajectory predictor."""
