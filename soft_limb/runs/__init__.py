"""Runs of limbs: a plan replayed, a motion taught and followed, repetitions."""

OPEN_LOOP = "open-loop"
CONTROLLERS = {  # their classes in `controllers`, which take long to import, by their names here
    OPEN_LOOP: "",
    "plan-feedback": "PlanFeedback",
    "plan-regulator": "PlanRegulator",
    "receding-horizon": "RecedingHorizon",
}
