"""The manipulator as URDF, SDFormat and MJCF: the default limb, and generators for others."""

from urdf.generate import limb_urdf, robot_urdf
from urdf.mjcf import limb_mjcf, robot_mjcf
from urdf.sdf import limb_sdf

__all__ = ["limb_mjcf", "limb_sdf", "limb_urdf", "robot_mjcf", "robot_urdf"]
