"""Speed, measured together with references in one process: `python -m benchmarks.run`."""
