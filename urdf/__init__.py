"""The manipulator as URDF: the default limb, and the generator for any other."""

from urdf.generate import limb_urdf

__all__ = ["limb_urdf"]
