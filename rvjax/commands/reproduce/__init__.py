"""`rvjax reproduce`: published values beside computed ones, with a verdict."""
