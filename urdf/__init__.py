"""The manipulator as URDF and SDFormat: the default limb, and generators for others and robots."""

from urdf.generate import limb_urdf, robot_urdf
from urdf.sdf import limb_sdf

__all__ = ["limb_sdf", "limb_urdf", "robot_urdf"]
