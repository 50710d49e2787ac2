"""Traffic that keeps to the recording and reacts to the ego."""
