"""The emulation: a limb with more physics than the model, and a board that runs the firmware."""
