"""Run ``soft-limb`` as ``python -m soft_limb``."""

import sys

from soft_limb.command import main

if __name__ == "__main__":
    sys.exit(main())
