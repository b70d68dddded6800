"""Random inputs over the domain of every model and beyond it, each checked: `python -m benchmarks.census.extremes`."""
