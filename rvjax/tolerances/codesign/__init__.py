"""Half-widths, mid-points and numbers of the design in one programme of least cost."""
