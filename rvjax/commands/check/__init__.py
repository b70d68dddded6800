"""`rvjax check`: the values that follow from a study, before anything is computed."""
