"""`rvjax export`: the joint model of a reducer as a file for a simulator."""
