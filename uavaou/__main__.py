"""``python -m uavaou``: the command line."""

import sys

from uavaou_cli.main import main

if __name__ == "__main__":
    sys.exit(main())
