"""The manipulator as URDF: the default limb, and the generators for any other and for robots."""

from urdf.generate import limb_urdf, robot_urdf

__all__ = ["limb_urdf", "robot_urdf"]
