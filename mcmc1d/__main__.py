"""`python -m mcmc1d`: the command line."""

import sys

from mcmc1d.cli import main

if __name__ == "__main__":
    sys.exit(main())
