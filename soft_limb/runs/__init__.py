"""Runs of limbs: a plan replayed, a motion taught and followed, repetitions."""

OPEN = "open-loop"
CONTROLLERS = {  # their classes in `controllers`, which take long to import, by their names here
    OPEN: "",
    "plan-feedback": "PlanFeedback",
    "plan-regulator": "PlanRegulator",
    "receding-horizon": "RecedingHorizon",
}
