"""Random inputs over the domain of every model and beyond it, each judged: `python -m census.extremes`."""
