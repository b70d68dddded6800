"""`rvjax init`: a commented study file to change."""
