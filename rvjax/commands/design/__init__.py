"""`rvjax design`: numbers of the design and tolerances together, the cheapest that meet the requirements of a study."""
