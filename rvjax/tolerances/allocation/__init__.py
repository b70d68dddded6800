"""The cheapest tolerances that meet the requirements."""
