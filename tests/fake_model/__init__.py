"""A keyed shaft under torque, a model that rvjax does not have: a new model is one package and one line."""
