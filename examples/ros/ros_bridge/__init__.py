"""A limb on ROS 2 topics: a loop that drives it, and a process that speaks DDS."""
