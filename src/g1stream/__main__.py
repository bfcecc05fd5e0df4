"""Entry point of `python -m g1stream`, the same as `g1stream`."""

import sys

from g1stream.cli.main import main

if __name__ == "__main__":
    sys.exit(main())
