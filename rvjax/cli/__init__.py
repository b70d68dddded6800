"""The command line; `main` is its door."""

from rvjax.cli.main import main as main
