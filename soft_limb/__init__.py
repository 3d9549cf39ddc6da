"""The application: commands, runs of limbs, reports, and readers of result files."""

from soft_limb.startup import let_ctrl_c_end_imports

let_ctrl_c_end_imports()
