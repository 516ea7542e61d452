"""``python -m uavaou``: the command line."""

import sys

from uavaou_cli import start

if __name__ == "__main__":
    sys.exit(start())
