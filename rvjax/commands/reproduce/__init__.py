"""`rvjax reproduce`: published and computed values, with a verdict."""
