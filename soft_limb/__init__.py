"""The application: commands, runs of limbs, reports, and what results are."""

import limb_systems  # noqa: F401 - before what takes long, see limb_systems.startup
