"""A model that rvjax does not have, a keyed shaft under torque: what a new model costs is this package and one line."""
