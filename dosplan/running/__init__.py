"""Many episodes: what a run is, who drives its episodes, and how every one becomes a row."""
