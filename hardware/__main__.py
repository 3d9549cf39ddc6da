"""``python -m hardware``: ``soft-limb`` with the commands of robots."""

import sys

from soft_limb.command import main

if __name__ == "__main__":
    sys.exit(main(package="hardware"))
