"""Joint models as text of the files that simulators read, one module for each format."""
