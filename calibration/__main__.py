"""``python -m calibration``: ``soft-limb`` with the commands of calibration."""

import sys

from soft_limb.command import main

if __name__ == "__main__":
    sys.exit(main(package="calibration"))
