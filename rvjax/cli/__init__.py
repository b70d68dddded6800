"""Command line; entry point `main`."""

from rvjax.cli.main import main as main
