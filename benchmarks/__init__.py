"""Speed, measured beside references in one process: `python -m benchmarks.run`."""
