"""``python -m planners``: ``soft-limb plan``."""

import sys

from soft_limb.command import main

if __name__ == "__main__":
    sys.exit(main(package="planners"))
