"""`python -m rvjax` is the command line."""

import sys

from rvjax.cli import main

if __name__ == "__main__":
    sys.exit(main())
