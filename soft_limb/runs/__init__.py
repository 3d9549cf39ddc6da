"""Runs of limbs: a plan replayed, a motion taught and followed, repetitions."""

OPEN_LOOP = "open-loop"
CONTROLLERS = {  # names at the command line: classes in `controllers`, which take long to import
    OPEN_LOOP: "",
    "plan-feedback": "PlanFeedback",
    "plan-regulator": "PlanRegulator",
    "receding-horizon": "RecedingHorizon",
}
