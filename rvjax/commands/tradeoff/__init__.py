"""`rvjax tradeoff`: time and error of the levels of every model, measured here."""
