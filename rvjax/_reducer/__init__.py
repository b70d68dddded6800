"""Private parts of the description of a reducer: error metadata, crank bearings, the flank, plausible ranges."""
