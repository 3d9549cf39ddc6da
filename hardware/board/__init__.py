"""The robot: the host's end of the serial cable, and the limb behind it as a system."""
