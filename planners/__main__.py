"""``python -m planners``: ``soft-limb plan``."""

import sys

from soft_limb.commands.plan import main

if __name__ == "__main__":
    sys.exit(main())
